# SPDX-License-Identifier: Apache-2.0
"""The robot file as values. Rules for one value alone are here; rules for several values together
are in `rules`.

Every number has a unit in its name, a range, and its unit as data in the JSON Schema. Defaults are
on the slow and careful side."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal

from motord.config import transfer
from motord.config.problems import Problem
from motord.config.sections.bases import AnyBase, Place
from motord.config.sections.battery import DrivesBattery, InaBattery
from motord.config.sections.bus import (
    BusInput,
    FoxgloveInput,
    FoxglovePublish,
    JoystickInput,
    McapPublish,
    MqttInput,
    MqttPublish,
    OtherInput,
    OtherPublish,
    PrometheusPublish,
    RclpyInput,
    Ros2Input,
    Ros2Publish,
    RosbridgeInput,
    RosbridgePublish,
    StdoutPublish,
    UdpPublish,
    WebInput,
    WebPublish,
    ZenohInput,
    ZenohPublish,
)
from motord.config.sections.guard import EstopInput, WatchdogOutput
from motord.config.sections.imu import ChipImu, LineImu
from motord.config.sections.joint.derating import Derating
from motord.config.sections.joint.encoder import AnyEncoder
from motord.config.sections.joint.feedback import FeedbackChecks
from motord.config.sections.joint.speed_loop import SpeedLoop
from motord.config.sections.limits import Limits
from motord.config.sections.line import Cpus, LineSection
from motord.config.sections.odometry import Odometry
from motord.config.sections.section import Field, Name, PrivateAttr, Section, number
from motord_hal.fieldbus.ports import REST_VELOCITY_RAD_S

if TYPE_CHECKING:
    from motord_hal.drives.profile import DriveProfile

_NONE: Mapping[str, DriveProfile] = MappingProxyType({})
StopAction = Literal["ramp", "brake", "hold", "coast"]


class RobotName(Section):
    """Name of this robot."""

    name: Name
    """Name of the robot, and part of the names of its socket and its state page."""


class Loop(Section):
    """The real-time loop."""

    rate_hz: float = number("ticks a second", 10, 20000, "Hz", 1000.0)
    priority: int = number("SCHED_FIFO priority; 0: ordinary scheduling", 0, 99, "1", 80)
    cpu: Cpus = Field(default=(), strict=False)
    """CPUs the loop may run on, each 0 to 63; none: all of them."""
    lock_memory: bool = True
    """Keep the daemon's memory from being paged out."""
    hold_dma_latency: bool = True
    """Keep the CPUs out of deep sleep while the loop runs."""


class Safety(Section):
    """When the robot stops, and how."""

    command_timeout_s: float = number("an older command is ignored", 0.02, 5, "s", 0.3)
    feedback_timeout_s: float = number(
        "no feedback of a wheel for this long is a fault", 0.005, 5, "s", 0.25
    )
    heartbeat_timeout_s: float = number(
        "the loop stops the robot when the daemon has hung for this long", 0.05, 5, "s", 0.5
    )
    drive_watchdog_s: float = number(
        "the drives stop by themselves when they have received nothing for this long",
        0.01,
        10,
        "s",
        0.5,
    )
    timeout_travel_max_m: float = number(
        "the check refuses a time of this table in which the robot goes this far at its limit",
        0.1,
        1000,
        "m",
        5.0,
    )
    rest_velocity_rad_s: float = number(
        "a wheel slower than this is at rest", 0.001, 10, "rad/s", REST_VELOCITY_RAD_S
    )
    on_timeout: StopAction = "ramp"
    """How to stop when the command is old."""
    on_fault: StopAction = "ramp"
    """How to stop when something is wrong."""
    on_estop: StopAction = "brake"
    """How to stop at the emergency stop."""
    estop: EstopInput | None = None
    watchdog: WatchdogOutput | None = None
    feedback: FeedbackChecks = Field(default_factory=FeedbackChecks)
    on_battery_critical: Literal["none", "stop"] = "none"
    """What a critical battery does: "none" reports it, "stop" stops the robot by on_fault and
    refuses to arm it. "none" is the default because a robot that still drives can drive to its
    charger."""


class Joint(Section):
    """One driven wheel, or one joint without a base."""

    line: str
    """Name of the line that the joint's drive is connected to."""
    drive: str
    """Name of the joint's drive profile (motord drives), or a profile's file (NAME.toml) beside the
    robot file."""
    unit: int = number(
        "Modbus address, or node on the CAN bus, of its drive; a board has none", 0, 255, "1", 1
    )
    channel: int = number("which motor of the drive", 1, 8, "1", 1)
    side: Literal["left", "right"] | None = None
    """Side of the wheel, on a base with wheels on two sides."""
    place: Place | None = None
    """Place of the wheel, on a mecanum base or a base with steered wheels."""
    steers: bool = False
    """Only on a base with steered wheels: the joint turns the wheel at its place about the
    vertical; its drive takes positions."""
    position_min_rad: float | None = number(
        "of a joint that steers: the farthest to the right, from straight ahead; without a base: "
        "the least angle",
        -1000,
        0,
        "rad",
        None,
    )
    position_max_rad: float | None = number(
        "of a joint that steers: the farthest to the left, from straight ahead; without a base: "
        "the greatest angle",
        0,
        1000,
        "rad",
        None,
    )
    acceleration_max_rad_s2: float = number(
        "of a joint that steers, or without a base: how fast its speed changes at most",
        0.1,
        10000,
        "rad/s²",
        20.0,
    )
    deceleration_max_rad_s2: float | None = number(
        "of a joint without a base that takes velocities: how fast its speed falls at most; as the "
        "acceleration where it is not given",
        0.1,
        10000,
        "rad/s²",
        None,
    )
    jerk_max_rad_s3: float = number(
        "of a joint without a base that takes velocities: its jerk; inf: no limit",
        0.1,
        None,
        "rad/s³",
        math.inf,
    )
    zero_count: int = number(
        "of a joint that steers, or without a base: what its counter shows where its angle is 0, a "
        "wheel pointing straight ahead",
        -(1 << 63),
        (1 << 63) - 1,
        "1",
        0,
    )
    angle_rad: float | None = number(
        "of an omni base: where the wheel is, seen from the middle; 0 is forward, pi / 2 left",
        -6.2832,
        6.2832,
        "rad",
        None,
    )
    x_m: float | None = number(
        "the wheel's place, forward of the middle: of an omni base instead of the angle, of a "
        "swerve base instead of `place`",
        -10,
        10,
        "m",
        None,
    )
    y_m: float | None = number(
        "the wheel's place, to the left of the middle, as x_m",
        -10,
        10,
        "m",
        None,
    )
    rolling_rad: float | None = number(
        "of an omni base: where the wheel rolls to when it turns forward, from straight ahead; "
        "across the line to the middle, counterclockwise, where it is not given",
        -6.2832,
        6.2832,
        "rad",
        None,
    )
    gear_ratio: float = number("motor turns for a wheel turn", 0.001, 10000, "1", 1.0)
    inverted: bool = False
    """The motor turns backward when the robot drives forward."""
    reversible: bool | None = None
    """Whether the wheel may turn backward; if this is not given, it may where the drive can."""
    wheel_radius_m: float | None = number("radius; the base's if not given", 0.005, 5, "m", None)
    velocity_max_rad_s: float | None = number(
        "the wheel's speed at most; what the drive can where it is not given",
        0.01,
        10000,
        "rad/s",
        None,
    )
    counts_per_turn: int | None = number(
        "encoder counts for a motor turn, where they are not the profile's; 0: no encoder",
        0,
        1 << 30,
        "1",
        None,
    )
    encoder: AnyEncoder | None = None
    duty_dead_band: float = number("duty at which the motor just turns", 0, 0.9, "1", 0.0)
    duty_min: float = number("least duty; 0: never backward", -1, 0, "1", -1.0)
    duty_max: float = number("greatest duty", 0.01, 1, "1", 1.0)
    duty_slew_per_s: float = number(
        "greatest rise of the duty; inf: no limit", 0.01, None, "1/s", math.inf
    )
    full_duty_rad_s: float | None = number(
        "the wheel's speed at duty 1: a drive that takes a duty needs it",
        0.01,
        10000,
        "rad/s",
        None,
    )
    speed_loop: SpeedLoop | None = None
    """How motord holds the wheel's speed: for a drive that takes a torque, and for one that takes a
    duty where its wheel is measured. Without it, a duty follows the open-loop map."""
    derating: Derating | None = None
    """How the base becomes slower with the temperature, current and supply voltage of its drive."""
    differs_in: tuple[
        Literal["gear_ratio", "counts_per_turn", "wheel_radius_m", "full_duty_rad_s"], ...
    ] = Field(default=(), strict=False)
    """Keys in which this joint is meant to differ from the other wheels of its base. `motord check`
    refuses any other difference between wheels with the same drive."""
    identity: dict[str, int] = Field(default_factory=dict)
    """What a register of its drive has to read at each set-up, as the raw number in it: a serial
    number, or another model than the profile's. Otherwise the drive is refused."""
    pins: dict[str, str] = Field(default_factory=dict)
    """On a line of kind "pwm": place of each pin of the bridge: pwmN, or a GPIO line's name or
    number; with ! before it, it is active low. Every bridge may have "fault", an input, and "pump",
    which changes with every cycle while the motor may move."""
    tries: int = number("requests before the drive counts as unresponsive", 1, 10, "1", 3)
    reply_timeout_s: float | None = number(
        "deadline for a reply; from baud rate, length and drive where it is not given",
        0.001,
        1,
        "s",
        None,
    )
    cycle_hz: float | None = number(
        "exchanges a second with its drive; the line's where it is not given", 1, 1000, "Hz", None
    )
    drive_watchdog_s: float | None = number(
        "on CAN and of boards that read text: the watchdog that was set in its drive with the "
        "maker's tool or by the prefix, where motord cannot set it; as safety.drive_watchdog_s",
        0.01,
        10,
        "s",
        None,
    )


class SocketInput(Section):
    """Commands from the local socket: motord drive, move, turn, and motord.client. They are taken
    whether or not the robot file has this section, unless it has enabled = false."""

    kind: Literal["socket"]
    enabled: bool = True
    """Whether the local socket may move the robot. Stop, e-stop and disarm work in any case."""
    priority: int = number("the higher one commands", 0, 1000, "1", 100)
    lease_s: float = number("lifetime of a command that gives none", 0.02, 5, "s", 0.3)


class RtInput(Section):
    """Commands as datagrams that the loop itself receives, whatever Python does."""

    kind: Literal["rt"]
    priority: int = number("the higher one commands", 0, 1000, "1", 100)
    lease_s: float = number("lifetime of a command that gives none", 0.02, 5, "s", 0.3)
    rate_max_hz: float | None = number(
        "commands that come more often are refused, but for zero", 1, 10000, "Hz", None
    )
    udp_port: int | None = number(
        "UDP port on 127.0.0.1; where it is not given, the Unix socket only", 1024, 65535, "1", None
    )


Input = (
    SocketInput
    | RtInput
    | MqttInput
    | RosbridgeInput
    | FoxgloveInput
    | WebInput
    | JoystickInput
    | Ros2Input
    | ZenohInput
    | RclpyInput
    | OtherInput
)
AnyPublish = (
    StdoutPublish
    | UdpPublish
    | MqttPublish
    | RosbridgePublish
    | FoxglovePublish
    | McapPublish
    | PrometheusPublish
    | WebPublish
    | Ros2Publish
    | ZenohPublish
    | OtherPublish
)


_SENT_OF_COMMANDERS = ("kind", "priority", "lease_s", "goal_lease_s")


class Robot(Section):
    """A robot file. `load_robot` reads one."""

    robot: RobotName
    loop: Loop = Field(default_factory=Loop)
    base: Annotated[AnyBase, Field(discriminator="kind")]
    limits: Limits = Field(default_factory=Limits)
    safety: Safety = Field(default_factory=Safety)
    odometry: Odometry = Field(default_factory=Odometry)
    battery: Annotated[DrivesBattery | InaBattery, Field(discriminator="source")] | None = None
    imu: Annotated[ChipImu | LineImu, Field(discriminator="source")] | None = None
    line: dict[Name, LineSection]
    """The fieldbus lines by name."""
    joint: dict[Name, Joint]
    """The driven wheels or joints by name; their order is that of the core's joints."""
    input: dict[Name, Annotated[Input, Field(discriminator="kind")]] = Field(default_factory=dict)
    """Inputs that may command, by name. The local socket may command, unless a section of kind
    "socket" disables it."""
    publish: dict[Name, Annotated[AnyPublish, Field(discriminator="kind")]] = Field(
        default_factory=dict
    )

    _path: Path = PrivateAttr(Path())
    _text: str = PrivateAttr("")
    _overrides: tuple[str, ...] = PrivateAttr(())
    _warnings: tuple[Problem, ...] = PrivateAttr(())
    _profiles: str = PrivateAttr("")
    """As text: motord-bus has the robot, too, and must not load the modules of the drives."""

    @property
    def path(self) -> Path:
        """The file that the robot was read from; drive profiles beside it are found, too."""
        return self._path

    @property
    def text(self) -> str:
        """Content of the file."""
        return self._text

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Problems that are no errors, but deserve a look."""
        return self._warnings

    @property
    def overrides(self) -> tuple[str, ...]:
        """The --set options with which the file was read: another process needs them, too."""
        return self._overrides

    @property
    def local_input(self) -> SocketInput:
        """Settings for commands from the local socket; see its `enabled`."""
        own = (found for found in self.input.values() if isinstance(found, SocketInput))
        return next(own, SocketInput(kind="socket"))

    def commanders(self) -> list[dict[str, Any]]:
        """Return name, kind, priority, lease_s, and goal_lease_s if it is given, of every source
        that may command the robot, the local socket first."""
        found: dict[str, Input] = {"local socket": self.local_input}
        found |= {name: section for name, section in self.input.items() if section.kind != "socket"}
        return [
            {"name": name}
            | {
                key: value
                for key in _SENT_OF_COMMANDERS
                if (value := getattr(section, key, None)) is not None
            }
            for name, section in found.items()
            if not isinstance(section, SocketInput) or section.enabled
        ]

    @property
    def has_bus(self) -> bool:
        """Whether the second process has anything to publish or to take commands from."""
        inputs = any(
            isinstance(section, BusInput) and not isinstance(section, RclpyInput)
            for section in self.input.values()
        )
        own = (StdoutPublish, UdpPublish)
        return inputs or any(not isinstance(section, own) for section in self.publish.values())

    @property
    def has_journal(self) -> bool:
        """Whether the core's input is recorded."""
        return any(
            isinstance(section, McapPublish) and section.journal
            for section in self.publish.values()
        )

    def read_from(
        self,
        path: Path,
        text: str = "",
        warnings: Iterable[Problem] = (),
        overrides: Iterable[str] = (),
        profiles: Mapping[str, DriveProfile] = _NONE,
    ) -> Robot:
        """Note the file, its content, its warnings, its --set options, and the profiles of its
        drives; return self."""
        self._path, self._text = path, text
        self._warnings, self._overrides = tuple(warnings), tuple(overrides)
        self._profiles = transfer.dumps(dict(profiles))
        return self

    @property
    def profiles(self) -> dict[str, DriveProfile]:
        """The profiles of the robot's drives, by the name that the robot file gives them."""
        return profiles_of(self._profiles)

    @property
    def profiles_text(self) -> str:
        """The same as text, which `profiles_of` reads."""
        return self._profiles

    def wheel_radius_m(self, joint: str) -> float:
        """Return a joint's own wheel radius, else the base's."""
        own = self.joint[joint].wheel_radius_m
        return self.base.wheel_radius_m if own is None else own


def profiles_of(text: str) -> dict[str, DriveProfile]:
    """Return drive profiles from their text, `Robot.profiles_text`. Raises ValueError for other
    text; the values have the types of the text, which is not checked."""
    from motord_hal.drives import can_profile, profile

    found = transfer.loads(text, transfer.classes_in(profile, can_profile))
    if not isinstance(found, dict) or not all(
        isinstance(one, profile.DriveProfile) for one in found.values()
    ):
        raise ValueError("not the form of drive profiles")
    return found
