# SPDX-License-Identifier: Apache-2.0
"""The answer of `status`, with a type for everything in it: docs/python.md.

Units are in the names. None: not measured, or never. A field that a daemon of another version does
not send keeps the default of its type: NaN, empty, False."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from motord.api.records import ImuStatus, JointStatus

NAN = math.nan


@dataclass(frozen=True, kw_only=True)
class Command:
    """The requested motion, and what the robot makes of it."""

    command_age_s: float | None = None
    """None: there was no command yet."""
    wanted_linear_m_s: float = NAN
    wanted_angular_rad_s: float = NAN
    wanted_lateral_m_s: float = NAN
    setpoint_linear_m_s: float = NAN
    """After limits and ramps."""
    setpoint_angular_rad_s: float = NAN
    setpoint_lateral_m_s: float = NAN
    saturation: float = NAN
    """1: no wheel is at its limit; less: all are slowed by this factor."""


@dataclass(frozen=True, kw_only=True)
class Odometry:
    """Pose since the last `reset_odometry`, and measured speed."""

    x_m: float = NAN
    y_m: float = NAN
    heading_rad: float = NAN
    distance_m: float = NAN
    turned_rad: float = NAN
    linear_m_s: float | None = None
    """None, as for the next three: the wheels with fresh feedback do not determine it."""
    angular_rad_s: float | None = None
    lateral_m_s: float | None = None
    """Positive to the left; 0 for a base that cannot move sideways."""
    slip_m_s: float | None = None
    """Speed of the rims against each other that no motion of the base explains, root mean
    square."""
    pose_covariance: tuple[float, ...] = ()
    """xx, xy, xh, yy, yh, hh in m2, m rad, rad2."""
    twist_covariance: tuple[float | None, ...] = ()
    """vv, vw, ww in m2/s2, m rad/s2, rad2/s2."""
    lateral_covariance: tuple[float | None, ...] = ()
    """vx vy, vy vy, vy w in m2/s2, m2/s2, m rad/s2."""
    degraded: bool = False
    coarse_counters: tuple[str, ...] = ()
    """Joints whose drive counts in a floating-point number that has become coarse."""
    """Whether a wheel is stale, or has no counter."""
    epoch: int = 0
    """Number of resets of the pose; it changes with each one."""
    age_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Joint(JointStatus):
    """A wheel and its drive."""

    drive: str = ""
    """unknown, ready, armed or unresponsive."""
    fault_words: tuple[str, ...] = ()
    takes_position: bool = False
    """Whether the joint takes positions; `position_rad` is then its angle."""


@dataclass(frozen=True, kw_only=True)
class Battery:
    """The robot file's [battery]."""

    state: str = ""
    voltage_v: float | None = None
    current_a: float | None = None
    temperature_c: float | None = None
    stamp_ns: int | None = None
    age_s: float | None = None
    cells: int | None = None
    capacity_ah: float | None = None


@dataclass(frozen=True, kw_only=True)
class Imu(ImuStatus):
    """The robot file's [imu]; values about the x, y and z axis of the base."""

    age_s: float | None = None


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Percentiles since the daemon's start."""

    p50: float = NAN
    p99: float = NAN
    p99_9: float | None = None
    max: float = NAN


@dataclass(frozen=True, kw_only=True)
class LoopStatus:
    """The real-time loop."""

    rate_hz: float = NAN
    policy: str = ""
    """SCHED_FIFO or SCHED_OTHER."""
    priority: int = 0
    ticks: int = 0
    overruns: int = 0
    page_faults: int = 0
    lateness_us: Spread = field(default_factory=Spread)
    step_ns: Spread = field(default_factory=Spread)
    refusals: Mapping[str, str] = field(default_factory=dict)
    """What the kernel did not grant, in words."""
    estop_input: str = ""
    watchdog: str = ""


@dataclass(frozen=True, kw_only=True)
class LineStatus:
    """A fieldbus line with its drives."""

    state: str = ""
    """closed, configuring or ready."""
    waits_for: str | None = None
    """Why the line or one of its drives cannot be armed; None: it can."""
    port: str = ""
    engine: str = ""
    exchanges: int = 0
    cycles: int = 0
    reopened: int = 0
    errors: Mapping[str, int] = field(default_factory=dict)
    cycle_hz: float = NAN
    """Cyclic rate of the drive that falls behind its rate most; 0: no drive has one."""
    requested_hz: float = NAN
    """The rate that the robot file requests of it."""
    wire_limit_hz: float = NAN
    """Rate that the wire carries if its drives answer at once."""
    round_trip_us: Spread = field(default_factory=Spread)


@dataclass(frozen=True, kw_only=True)
class LeaseStatus:
    """A source that has a lease; the source in command is the first."""

    number: int = 0
    owner: str = ""
    connection: int = 0
    priority: int = 0
    expires_in_s: float = NAN
    linear_m_s: float | None = None
    angular_rad_s: float | None = None
    lateral_m_s: float | None = None
    rate_hz: float | None = None
    held: bool = False
    """See `HeldStatus`."""
    sparse: str = ""
    """That its commands come less often than its lease, in words; empty: they do not."""
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class HeldStatus:
    """A source that moves nothing until it sends zero once, is started anew, or a person lets it go
    on."""

    owner: str = ""
    held_for_s: float = NAN
    silent_for_s: float | None = None
    """Time since its newest command; None: its connection has ended."""
    why: str = ""
    release: str = ""
    """How it moves the robot again."""


@dataclass(frozen=True, kw_only=True)
class Commander:
    """An input that may command."""

    name: str = ""
    kind: str = ""
    priority: int = 0
    lease_s: float = NAN


@dataclass(frozen=True, kw_only=True)
class Commands:
    """Counters since the daemon's start."""

    accepted: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    """Number of refused commands, by reason."""
    sideways: int = 0
    """Commands of lateral motion that were sent to a base that cannot move sideways."""
    on_spot: int = 0
    """Commands to turn on the spot that were sent to a base whose steering cannot do it."""


@dataclass(frozen=True, kw_only=True)
class Limited:
    """A reason why the set-point differs from the request."""

    for_s: float = NAN
    """How long the reason has held."""
    joint: str | None = None
    """Joint that causes "wheel_saturated" or "derated"; None for every other reason."""
    joints: tuple[str, ...] = ()
    """Joints that a reason such as "joint_position" limits; empty for reasons of the base."""
    by: str | None = None
    """Cause of a derating: temperature, current or voltage."""
    factor: float | None = None
    """The factor by which a derating multiplies the base's speed limits."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Status(dict[str, Any]):
    """Everything the daemon knows about itself and the robot. It is also the answer as a dict:
    `status.odometry.x_m` and `status["odometry"]["x_m"]` are the same number."""

    robot: str = ""
    pid: int = 0
    state: str = ""
    """off, configuring, idle, armed, moving, stopping, fault or estop."""
    why: tuple[str, ...] = ()
    """What caused the latched fault or emergency stop."""
    armed: bool = False
    at_rest: bool = False
    """Whether `rest` is "at_rest"."""
    rest: str = "unknown"
    """at_rest, turning or unknown."""
    rest_unknown_s: Mapping[str, float] = field(default_factory=dict)
    """Joints of which it is unknown whether they turn, and for how long it has been."""
    rest_unmeasured: tuple[str, ...] = ()
    """Joints that nothing measures: they count as at rest while their set-points are zero."""
    reasons: tuple[str, ...] = ()
    """Why the set-point differs from the request."""
    limited: Mapping[str, Limited] = field(default_factory=dict)
    """Each of `reasons` in detail."""
    parameters: Mapping[str, float | None] = field(default_factory=dict)
    """The limits in force, by the names of `params_list`; None: no limit."""
    faults: tuple[str, ...] = ()
    """The latched faults."""
    stops: int = 0
    """How often a stop, an emergency stop or a fault has brought the robot to rest."""
    command: Command = field(default_factory=Command)
    odometry: Odometry = field(default_factory=Odometry)
    joints: Mapping[str, Joint] = field(default_factory=dict)
    battery: Battery | None = None
    imu: Imu | None = None
    loop: LoopStatus = field(default_factory=LoopStatus)
    lines: Mapping[str, LineStatus] = field(default_factory=dict)
    leases: tuple[LeaseStatus, ...] = ()
    held: tuple[HeldStatus, ...] = ()
    """Sources that move nothing although the robot is armed, or would not if it were."""
    inputs: tuple[Commander, ...] = ()
    commands: Commands = field(default_factory=Commands)
    publishers: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Counters of the daemon's own publishers: "taken", "dropped", and "topics" by their names."""
    bus: Mapping[str, Any] | None = None
    """Status of the second process, motord-bus; None: the robot file has no bus."""
    stalls: Mapping[str, Any] = field(default_factory=dict)
    version: int = 0

    @classmethod
    def of(cls, answer: Mapping[str, Any]) -> Self:
        """Make a Status from the answer of `status`."""
        made: Self = _typed(cls)(answer)
        made.update(answer)
        return made


Convert = Callable[[Any], Any]


@functools.cache
def _typed(kind: Any) -> Convert:
    """Return the function that converts a JSON value to that type."""
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        keys = [(key.name, _typed(hints[key.name])) for key in dataclasses.fields(kind)]
        return lambda raw: kind(**{name: to(raw[name]) for name, to in keys if name in raw})
    arguments = typing.get_args(kind)
    if isinstance(kind, types.UnionType):  # X | None is the only one
        some = _typed(arguments[0])
        return lambda raw: None if raw is None else some(raw)
    origin = typing.get_origin(kind)
    if origin is tuple:
        item = _typed(arguments[0])
        return lambda raw: tuple(map(item, raw))
    if origin is Mapping:
        value = _typed(arguments[1])
        return lambda raw: {key: value(one) for key, one in raw.items()}
    return lambda raw: raw
