# SPDX-License-Identifier: Apache-2.0
"""A whole simulated robot: lines, drives, wheels and ground, a fault script, a control socket.

Its behaviour depends only on the requests and on the time given to `work`, so a test may step the
clock by hand. `runner` runs it in real time.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from motord_hal.drives.profile import DriveProfile
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.fieldbus.units import DriveKey, drive_key
from motord_hal.modbus.codec import character_bits
from motord_hal.modbus.timing import TCP_KINDS, line_gap_s
from motord_hal.servo.packets import KINDS as SERVO_KINDS
from motord_hal.sim.axis import Axis
from motord_hal.sim.boards.frame_talk import FrameTalk
from motord_hal.sim.boards.line import SimulatedBoard, Talk
from motord_hal.sim.boards.packet_talk import HoverboardTalk, SabertoothTalk
from motord_hal.sim.boards.text_talk import TextTalk
from motord_hal.sim.fault_kinds import FaultError
from motord_hal.sim.faults import Fault, FaultScript
from motord_hal.sim.ground import Module
from motord_hal.sim.gyro import SimulatedGyro
from motord_hal.sim.new_drive import new_drive
from motord_hal.sim.pins.bridge import SimulatedBridge
from motord_hal.sim.pins.folder import PinFolder
from motord_hal.sim.pins.line import SimulatedPins, channels_of
from motord_hal.sim.plant import SUBSTEP_S, Contact, Plant, Wheel, WheelModel
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.gateway import GatewayPort
from motord_hal.sim.rs485.line import SimulatedLine
from motord_hal.sim.rs485.port import Port, PtyPort
from motord_hal.sim.rs485.servo_line import SimulatedServoLine
from motord_hal.sim.rs485.tcp import RawTcpPort
from motord_hal.sim.rs485.wire import Clock
from motord_hal.sim.server import ControlServer

if TYPE_CHECKING:
    from motord_hal.sim.can.line import SimulatedCanLine

AnySimulatedLine: TypeAlias = "SimulatedLine | SimulatedBoard | SimulatedPins | SimulatedCanLine"
PUNCTUAL_KINDS = ("can", "pwm")
"""Kinds of lines whose values must be those of the time at which they are read."""
OTHER_THAN_CAN = SimulatedLine | SimulatedBoard | SimulatedPins
SIDES = ("left", "right")
"""Sides in the order of the numbers in the fault "slip"."""
REPLUG_RETRY_S = 0.1
JOURNAL_REPLY_ENTRIES = 1000
"""Greatest number of entries in one answer of the control socket. Read the rest with `since`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSpec:
    """A joint's properties for the ground."""

    side: str
    """"left" | "right"."""
    wheel_radius_m: float
    row: tuple[float, float, float] | None = None
    """The same as `Contact.row`."""
    full_duty_rad_s: float = 15.0
    """Wheel speed at full duty, for drives whose set-point is a duty."""
    counts_per_turn: int = 0
    """Counts for one turn of this motor's encoder; 0: the profile's value."""
    rolls: bool = True
    """Whether the joint turns a wheel on the ground; False: it steers one."""
    model: WheelModel = field(default_factory=WheelModel)


@dataclass(frozen=True, slots=True, kw_only=True)
class PortSpec:
    """A TCP socket in front of a line. Port 0: any free one."""

    host: str = "127.0.0.1"
    port: int = 0
    raw: bool = False
    """True: RTU frames as they are; False: a Modbus TCP gateway."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSpec:
    robot: str
    track_m: float
    """Effective distance of the sides; skid-steered: including the slip factor."""
    lines: tuple[LineSpec, ...]
    wheels: Mapping[str, WheelSpec]
    """Wheels by joint name."""
    modules: tuple[Module, ...] = ()
    """Wheels of a base with steered wheels; empty: another base."""
    seed: int = 0
    faults: tuple[str, ...] = ()
    slip_variance_m2_per_m: float = 0.0
    watchdog_s: float = 0.0
    """Watchdog time for drives whose profile has no watchdog; 0: none, like the real drive."""
    gyro_scale: float = 1.0
    """Measured over true rate of turn."""
    ports: Mapping[str, PortSpec] = field(default_factory=dict)
    """Sockets by line name. A line without one is a pseudo-terminal, or on any free TCP port of
    this machine if its kind is TCP."""
    can: str = ""
    """INTERFACE:CHANNEL of the robot's one CAN bus; "": each line has its own on UDP datagrams."""
    units: int = 0
    """Least number of drives on each line, from unit 1 on. Spare ones are like its first drive."""
    tagged: bool = False
    """Whether counters start at a number that identifies the unit, and answers are kept
    (Journal)."""


class Rig:
    """A simulated robot. Raises FaultError for an unknown fault, OSError for a path that cannot be
    used. Close it, or use it as a context."""

    def __init__(
        self, spec: RigSpec, *, link_dir: Path | None = None, control: Path | None = None
    ) -> None:
        self.spec = spec
        self._own_dir: tempfile.TemporaryDirectory[str] | None = None
        if link_dir is None:
            self._own_dir = tempfile.TemporaryDirectory(prefix="motord-sim-")
            link_dir = Path(self._own_dir.name)
        link_dir.mkdir(parents=True, exist_ok=True)
        self.script = FaultScript(spec.seed)
        self.plant = self._make_plant()
        self.lines = {line.name: self._make_line(line, link_dir) for line in spec.lines}
        self._drives = [drive for line in self.lines.values() for drive in line.drives.values()]
        self._punctual = any(line.kind in PUNCTUAL_KINDS for line in spec.lines)
        self._replug_s: dict[str, float] = {}
        self.began_ns = time.monotonic_ns()
        self.held_up_max_s = 0.0
        """Longest time without a processor since reset_truth, as measured by the runner."""
        if spec.tagged:
            self._tag()
        for text in spec.faults:
            self._add(text)
        self.server = ControlServer(control or link_dir / "control.sock", self._methods())
        try:
            self.plug()
        except OSError:
            self.close()
            raise

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.server.close()
        for line in self.lines.values():
            line.pull()
            if isinstance(line, SimulatedPins):
                line.port.remove()
        if self._own_dir is not None:
            self._own_dir.cleanup()

    # ------------------------------------------------------------------------------------ building
    def _make_plant(self) -> Plant:
        wheels = {}
        for line in self.spec.lines:
            for key, profile in self._profiles(line).items():
                for number in profile.channels:
                    wheels[_free_name(line, key, number)] = Wheel(WheelModel())
            for joint in line.joints:
                del wheels[_free_name(line, drive_key(joint), joint.channel)]
                wheels[joint.name] = Wheel(self.spec.wheels[joint.name].model)
        contacts = {
            name: Contact(side=wheel.side, wheel_radius_m=wheel.wheel_radius_m, row=wheel.row)
            for name, wheel in self.spec.wheels.items()
            if wheel.rolls
        }
        return Plant(
            wheels,
            contacts,
            self.spec.track_m,
            modules=self.spec.modules,
            slip_variance_m2_per_m=self.spec.slip_variance_m2_per_m,
            seed=self.spec.seed,
        )

    def _profiles(self, line: LineSpec) -> dict[DriveKey, DriveProfile]:
        """Return the profile of each drive: the robot's, and those of the spare units."""
        own = {drive_key(joint): joint.profile for joint in line.joints}
        taken = {unit for unit, _ in own}
        _, path = drive_key(line.joints[0])
        spare = [(unit, path) for unit in range(1, self.spec.units + 1) if unit not in taken]
        return dict.fromkeys(spare, line.joints[0].profile) | own

    def _make_line(self, line: LineSpec, link_dir: Path) -> AnySimulatedLine:
        by_key = {}
        for key, profile in self._profiles(line).items():
            axes = {
                number: Axis(wheel=self.plant.wheels[name])
                for number in profile.channels
                if (name := _free_name(line, key, number)) in self.plant.wheels
            }
            axes |= {j.channel: self._axis(j) for j in line.joints if drive_key(j) == key}
            by_key[key] = new_drive(profile, key[0], axes, watchdog_s=self._watchdog_s(profile))
        if line.kind == "can":
            return self._make_can_line(line, by_key, link_dir)
        drives = {drive.unit: drive for drive in by_key.values()}
        if line.kind == "pwm":
            return self._make_pins(line, drives, link_dir)
        port = self._make_port(line, link_dir)
        talks = self._make_talks(line)
        if talks:
            return SimulatedBoard(line, drives, self.script, port, talks)
        if line.kind in SERVO_KINDS:
            return SimulatedServoLine(line, drives, self.script, port)
        return SimulatedLine(line, drives, self.script, port)

    def _make_talks(self, line: LineSpec) -> dict[int, Talk]:
        """Return each board's protocol by its address; empty: no board is on this line."""
        units = {joint.unit: joint.profile for joint in line.joints}
        talks = {unit: self._make_talk(line, unit, profile) for unit, profile in units.items()}
        return {unit: talk for unit, talk in talks.items() if talk is not None}

    def _make_talk(self, line: LineSpec, unit: int, profile: DriveProfile) -> Talk | None:
        if line.kind == "mcu":
            return FrameTalk(profile, lambda: self.plant.time_s, self._make_gyro(line))
        if line.kind == "ascii":
            return TextTalk(line, self._make_gyro(line))
        if line.kind == "hoverboard":
            return HoverboardTalk(profile)
        if line.kind == "sabertooth":
            return SabertoothTalk(profile, unit)
        return None

    def _watchdog_s(self, profile: DriveProfile) -> float:
        """Return the time of a watchdog that cannot be set; 0: no such watchdog."""
        return 0.0 if profile.watchdog else self.spec.watchdog_s or profile.watchdog_fixed_s

    def _make_gyro(self, line: LineSpec) -> SimulatedGyro | None:
        if line.imu is None:
            return None
        scale = self.spec.gyro_scale
        return SimulatedGyro(self.plant, line.imu, self.spec.seed, scale=scale)

    def _make_can_line(
        self, line: LineSpec, drives: Mapping[DriveKey, SimulatedDrive], link_dir: Path
    ) -> SimulatedCanLine:
        # python-can is needed only for a robot with a CAN bus
        from motord_hal.sim.can.line import SimulatedCanLine
        from motord_hal.sim.can.port import BusSettings, CanPort, free_address

        settings = BusSettings(line.baudrate, line.data_baudrate)
        own = line.port if line.port.startswith("unix:") else ""  # such a bus needs no hardware
        if not own and any(joint.profile.goes_to_positions for joint in line.joints):
            own = f"unix:{link_dir / line.name}"  # only the engine in C supports positions
        port = CanPort(self.spec.can or own or free_address(), settings)
        return SimulatedCanLine(line, drives, self.script, port)

    def _make_pins(
        self, line: LineSpec, drives: Mapping[int, SimulatedDrive], link_dir: Path
    ) -> SimulatedPins:
        bridges = {u: each for u, each in drives.items() if isinstance(each, SimulatedBridge)}
        places = itertools.chain.from_iterable(channels_of(line.joints))
        channels = [place.channel for place in places if place.channel is not None]
        counters = sum(joint.encoder is not None for joint in line.joints)
        return SimulatedPins(line, bridges, PinFolder(link_dir / line.name, channels, counters))

    def _make_port(self, line: LineSpec, link_dir: Path) -> Port:
        wanted = self.spec.ports.get(line.name)
        if wanted is None and line.kind not in TCP_KINDS:
            return PtyPort(link_dir / line.name)
        tcp = wanted or PortSpec(raw=line.kind == "rtu-over-tcp")
        if tcp.raw:
            return RawTcpPort(tcp.host, tcp.port)
        character_s = character_bits(line.parity, line.stop_bits) / line.baudrate
        gap_s = line_gap_s(line)
        return GatewayPort(tcp.host, tcp.port, character_s=character_s, gap_s=gap_s)

    def _tag(self) -> None:
        for drive in self._drives:
            drive.tag_counters()
            drive.journal.kept = True

    def _axis(self, joint: JointSpec) -> Axis:
        wheel = self.spec.wheels[joint.name]
        return Axis(
            wheel=self.plant.wheels[joint.name],
            gear_ratio=joint.gear_ratio,
            inverted=joint.inverted,
            full_duty_rad_s=wheel.full_duty_rad_s,
            counts_per_turn=wheel.counts_per_turn,
        )

    # ------------------------------------------------------------------------------------- running
    @property
    def pauses(self) -> bool:
        """Whether the time has to stand still while the process gets no CPU. A late frame is only
        late, but a counter that jumps is read on time, and no wheel turns so far."""
        return any(line.kind == "pwm" for line in self.spec.lines)

    def filenos(self, now_s: float) -> list[int]:
        """Return the descriptors to wait for with select."""
        ports = [fd for line in self.lines.values() for fd in line.port.filenos(now_s)]
        return [*ports, *self.server.filenos()]

    def due_s(self, now_s: float | None = None) -> float:
        """Return the time of the next event without a request."""
        at_s = self.plant.time_s if now_s is None else now_s
        return min((line.due_s(at_s) for line in self.lines.values()), default=math.inf)

    def work(self, now_s: float) -> None:
        """Advance everything to `now_s` since the start; a time in the past does nothing."""
        while self.substep_due(now_s):
            self.substep()
        for line in self.lines.values():
            line.work(now_s)

    def work_lines(self, clock: Clock) -> None:
        """Serve only the wires, by a clock that continues meanwhile. CAN frames carry the time at
        which they went out, and counters that of the reading, so their content has to be of that
        time."""
        while self._punctual and self.substep_due(clock()):
            self.substep()
        for line in self.lines.values():
            line.work(clock(), clock)

    def substep_due(self, now_s: float) -> bool:
        return self.plant.time_s + SUBSTEP_S <= now_s

    def substep(self) -> None:
        """Advance the physics, the drives' clocks and the script by one step."""
        if self.script.faults or self.plant.slipping:
            self.plant.slipping = {
                SIDES[int(fault.values["side"])]: fault.values["part"]
                for fault in self.script.states("slip", None, self.plant.time_s)
            }
        self.plant.substep()
        now_s = self.plant.time_s
        for drive in self._drives:
            drive.suffer(self.script.defects(drive.unit, now_s))
            drive.tick(now_s)
        if self.script.faults or self._replug_s:
            self._do_due(now_s)

    def _do_due(self, now_s: float) -> None:
        for fault in self.script.due(now_s):
            self._happen(fault, now_s)
        for name in [name for name, at_s in self._replug_s.items() if now_s >= at_s]:
            self._replug(name, now_s)

    def _replug(self, name: str, now_s: float) -> None:
        """Plug the line in, or try again later: its old TCP port may be in use for a while."""
        try:
            self.lines[name].plug()
        except OSError:
            self._replug_s[name] = now_s + REPLUG_RETRY_S
        else:
            del self._replug_s[name]

    # -------------------------------------------------------------------------------------- faults
    def inject(self, text: str) -> None:
        """Add a fault to the script. Its times count from now. A fault that is due now has happened
        when this returns. Raises FaultError."""
        self._add(text)
        self._do_due(self.plant.time_s)

    def _add(self, text: str) -> None:
        fault = self.script.add(text, self.plant.time_s)
        try:
            self._check(fault)
        except ValueError as error:
            self.script.faults.remove(fault)
            raise FaultError(f'"{text}": {error}') from error

    def _check(self, fault: Fault) -> None:
        drives = self._concerned(fault)
        if not drives:
            raise ValueError(f"no unit {fault.values['unit']:g} here")
        if fault.kind == "fault":
            for drive in drives:
                drive.find_fault(*fault.of_drive)

    def _concerned(self, fault: Fault) -> list[SimulatedDrive]:
        unit = fault.values.get("unit")
        return [drive for drive in self._drives if unit in (None, drive.unit)]

    def _happen(self, fault: Fault, now_s: float) -> None:
        if fault.kind == "unplug":
            self.pull()
            self._replug_s = dict.fromkeys(self.lines, now_s + fault.values["for_s"])
        for line in self.lines.values():
            if fault.kind == "bus-off" and not isinstance(line, OTHER_THAN_CAN):
                line.go_off(now_s + fault.values["for_s"])
            elif fault.kind == "tcp-stall":
                line.port.stall(now_s + fault.values["for_s"])
            elif fault.kind == "half-open":
                line.port.forget()
        for drive in self._concerned(fault):
            match fault.kind:
                case "reboot":
                    drive.reboot(now_s, fault.values["for_s"])
                case "brown-out":
                    keeps = bool(fault.values["keep"])
                    drive.reboot(now_s, fault.values["for_s"], keeps_counter=keeps)
                case "fault":
                    drive.raise_fault(*fault.of_drive)
                case "encoder-wrap":
                    drive.start_near_wrap()

    def pull(self, line: str | None = None) -> None:
        """Pull the plug of one line, or of all lines."""
        for name in [line] if line else list(self.lines):
            self._line(name).pull()

    def plug(self, line: str | None = None) -> None:
        for name in [line] if line else list(self.lines):
            self._line(name).plug()

    def _line(self, name: str) -> AnySimulatedLine:
        if name not in self.lines:
            raise ValueError(f'no line "{name}"; known: {", ".join(self.lines)}')
        return self.lines[name]

    # ------------------------------------------------------------------------------ control socket
    def ports(self) -> dict[str, str]:
        return {name: line.port.address for name, line in self.lines.items()}

    def truth(self) -> dict[str, Any]:
        plant = self.plant
        return {
            "time_s": plant.time_s,
            **dataclasses.asdict(plant.truth),
            "at_rest": plant.at_rest,
            "rest_since_s": plant.rest_s,
            "joints": {
                joint.name: {
                    "position_rad": plant.wheels[joint.name].position_rad,
                    "velocity_rad_s": plant.wheels[joint.name].velocity_rad_s,
                    "current_a": plant.wheels[joint.name].current_a,
                    "enabled": _drive_of(line, joint).enabled(joint.channel),
                }
                for line in self.lines.values()
                for joint in line.spec.joints
            },
        }

    def reset_truth(self) -> None:
        self.plant.reset_truth()
        self.held_up_max_s = 0.0

    def stats(self) -> dict[str, Any]:
        return {
            "seed": self.script.seed,
            "held_up_max_s": self.held_up_max_s,
            "lines": {name: line.stats() for name, line in self.lines.items()},
            "past_faults": dict(self.script.past),
            "faults": [{"spec": fault.text, "fired": fault.fired} for fault in self.script.faults],
        }

    def journal(self, line: str, unit: int, since: int) -> list[dict[str, Any]]:
        """Return the real answers of a unit from entry `since` on. Only a tagged rig keeps them."""
        drives = [one for one in self._line(line).drives.values() if one.unit == unit]
        if not drives:
            raise ValueError(f"no unit {unit} on {line}")
        return drives[0].journal.since(since, self.began_ns, JOURNAL_REPLY_ENTRIES)

    def _methods(self) -> dict[str, Callable[[Mapping[str, Any]], Any]]:
        return {
            "truth": lambda _: self.truth(),
            "stats": lambda _: self.stats(),
            "journal": lambda params: self.journal(
                params["line"], int(params["unit"]), int(params.get("since", 0))
            ),
            "reset_truth": lambda _: self.reset_truth(),
            "inject": lambda params: self.inject(params["spec"]),
            "clear_faults_script": lambda _: self.script.clear(),
            "pull": lambda params: self.pull(params.get("line")),
            "plug": lambda params: self.plug(params.get("line")),
        }


def _drive_of(line: AnySimulatedLine, joint: JointSpec) -> SimulatedDrive:
    if isinstance(line, OTHER_THAN_CAN):
        return line.drives[joint.unit]
    return line.drives[drive_key(joint)]


def _free_name(line: LineSpec, key: DriveKey, channel: int) -> str:
    """Return the name of the wheel of a motor that no joint uses: it turns in the air."""
    unit, profile = key
    return f"{line.name} unit {unit} {profile or ''} channel {channel}"
