# SPDX-License-Identifier: Apache-2.0
"""What the core knows after a tick, as plain Python values.

Names, meanings and order are those of `robot_state` in api.h: `motord.api.state_page` decodes
by them. Everybody but the core only reads a snapshot: hence no import of the C core.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

SNAPSHOT_VERSION = 1
"""Raised when a field is renamed, removed or changes its meaning; not when one is added."""
STATES = ("off", "configuring", "idle", "armed", "moving", "stopping", "fault", "estop")
"""By `machine_state`."""
GYRO_STATES = ("none", "unbiased", "used", "stale", "reversed")
"""By GYRO_* of csrc/api/api_imu.h."""
DERATED_BY = ("temperature", "current", "voltage")
"""By DERATED_BY_* of csrc/api/api_derating.h."""


I64 = int
U64 = int
U32 = int
Vector3 = tuple[float, ...]
Planar6 = tuple[float, ...]
"""Upper triangle of a symmetric 3 × 3 matrix, row by row."""
Planar3 = tuple[float, ...]
"""Three numbers of a covariance."""
Joints8 = tuple[float, ...]
"""A number for each place of a joint."""
Reasons = tuple[str, ...]
Faults = tuple[str, ...]
FirstFault = str
DeratedBy = str
GyroState = str


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSnapshot:
    """One wheel. NaN: its drive does not measure that. `enabled` None: the drive cannot say."""

    position_rad: float
    velocity_rad_s: float
    setpoint_rad_s: float
    duty: float
    current_a: float
    voltage_v: float
    temperature_c: float
    feedback_age_s: float
    """Infinity: never received."""
    drive_faults: U32
    enabled: bool | None
    stale: bool
    jumps: U32


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSnapshot:
    """The inertial measurement unit, about the base's x, y, z. NaN: not measured, or not known
    yet."""

    stamp_ns: I64
    angular_rad_s: Vector3
    """About z without the zero-rate offset."""
    acceleration_m_s2: Vector3
    bias_rad_s: float
    """Zero-rate offset about z, estimated while the base stood."""
    bias_variance_rad2_s2: float
    rate_variance_rad2_s2: float
    """Of a sample about z, measured while the base stood."""
    state: GyroState
    """"unbiased" (the base has not stood still yet), "used", "stale", or "reversed" (it has turned
    against the wheels)."""
    heading_by_gyro: bool
    """The newest turn in the pose is the gyro's; else the wheels'."""
    still: bool
    """The base stands, by wheels and gyro: the heading is held."""
    refused: U32
    """Samples that were no numbers, off the scale or out of order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DoubtSnapshot:
    """Why a fault says that the feedback is not believed; of the first such fault."""

    since_ns: I64
    setpoint_rad_s: float
    measured_rad_s: float
    """By its counter where it has one, smoothed."""
    reported_rad_s: float
    """The drive's own measure. NaN: none."""
    fault: FirstFault
    """`direction`, `stall`, `following_error`, `runaway` or `implausible_feedback`."""
    joint: U32
    """Its place in the robot file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeratingSnapshot:
    """What makes the base slower; of the joint that does so most."""

    since_ns: I64
    factor: float
    """Of the base's speed limits."""
    joint: U32
    """Its place in the robot file."""
    by: DeratedBy
    """`temperature`, `current` or `voltage`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedLoopSnapshot:
    """What the core's speed loop makes of one wheel: a torque in N m, or a duty. 0: it has none."""

    output_u: float
    integral_u: float
    """Of the output."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """The robot after one tick. `stamp_ns` is CLOCK_MONOTONIC; publishers add the wall time."""

    stamp_ns: I64
    tick: U64
    machine_state: U32
    """The number of the state machine's state: docs/architecture.md."""
    owner: U32
    reasons: Reasons
    """Why the set-point is not what was asked for: `linear_jerk`, `command_stale`, ..."""
    faults: Faults
    """What is latched: `estop`, `feedback_stale`, ..."""
    armed: bool
    enabled: bool
    at_rest: bool
    odometry_degraded: bool
    odometry_epoch: U32
    dt_s: float
    command_age_s: float
    """Infinity: no command ever."""
    wanted_linear_m_s: float
    wanted_angular_rad_s: float
    setpoint_linear_m_s: float
    setpoint_angular_rad_s: float
    saturation: float
    odometry_stamp_ns: I64
    x_m: float
    y_m: float
    heading_rad: float
    distance_m: float
    turned_rad: float
    linear_m_s: float
    angular_rad_s: float
    pose_covariance: Planar6
    """xx, xy, xh, yy, yh, hh in m2, m rad, rad2."""
    twist_covariance: Planar3
    """vv, vw, ww in m2/s2, m rad/s2, rad2/s2."""
    joints: tuple[JointSnapshot, ...]
    wanted_lateral_m_s: float = 0.0
    setpoint_lateral_m_s: float = 0.0
    lateral_m_s: float = 0.0
    """Measured, positive to the left; 0 for a base that cannot move sideways."""
    slip_m_s: float = 0.0
    """Of the rims against each other, root mean square: what no motion of the base explains."""
    lateral_covariance: Planar3 = (0.0, 0.0, 0.0)
    """Of the twist: vx vy, vy vy, vy w in m2/s2, m2/s2, m rad/s2."""
    position_setpoints_rad: Joints8 = ()
    """Of joints that take positions; NaN: none."""
    misaligned_rad: float = 0.0
    """How far the worst steered wheel does not point to where it is to roll. Infinity: it is not
    known yet."""
    position_joints: U32 = 0
    """Bit n: joint n takes positions, and its `position_rad` is its angle."""
    position_unknown: U32 = 0
    """Bit n: where joint n is is not known."""
    imu: ImuSnapshot | None = None
    """None: there is none, or it was never received."""
    doubt: DoubtSnapshot | None = None
    speed_loops: tuple[SpeedLoopSnapshot, ...] = ()
    """By joint."""
    derating: DeratingSnapshot | None = None
    """None: no joint derates the base."""
    reasons_since_ns: Mapping[str, int] = field(default_factory=dict)
    """Since when each of `reasons` holds."""
    saturated_joint: int | None = None
    """While `wheel_saturated` is a reason: the place of the joint whose limit it is."""
    reason_joints: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """Of those of `reasons` that are about a duty, a position that is not known or joints without a
    base: the places of the joints that they come from."""
    version: int = SNAPSHOT_VERSION

    def to_json(self) -> dict[str, Any]:
        """Ready for json.dumps(allow_nan=False): NaN and infinities are None, tuples are lists."""
        return _record(self)


def derated_by(number: int) -> str:
    """What `by` of the C core's derating_shown means."""
    return DERATED_BY[number] if number < len(DERATED_BY) else f"reason {number}"


def gyro_word(state: int) -> str:
    """What `state` of the C core's imu_state means; a number that is not known is shown as it
    is."""
    return GYRO_STATES[state] if state < len(GYRO_STATES) else f"state {state}"


_Record = (
    Snapshot | JointSnapshot | ImuSnapshot | DoubtSnapshot | SpeedLoopSnapshot | DeratingSnapshot
)


_NAMES = {kind: tuple(key.name for key in dataclasses.fields(kind)) for kind in get_args(_Record)}
"""Of the fields, by the class: `fields` looks for them anew each time."""
_AS_IT_IS = frozenset((int, str, bool, type(None)))


def _record(record: _Record) -> dict[str, Any]:
    return {name: _plain(getattr(record, name)) for name in _NAMES[type(record)]}


def _plain(value: Any) -> Any:
    kind = type(value)
    if kind in _AS_IT_IS:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if kind in _NAMES:
        return _record(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return value
