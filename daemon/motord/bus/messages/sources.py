# SPDX-License-Identifier: Apache-2.0
"""Names that the expressions of `motord.bus.messages.tree` may use besides Python's: names of
frames and joints, constants, and pure functions of a snapshot."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from math import cos, isfinite, nan, sin
from typing import TYPE_CHECKING, NamedTuple

from motord.api.snapshot import (
    STATES,
    ImuSnapshot,
    JointSnapshot,
    Rest,
    Snapshot,
    joints_of,
    rest_report,
    rest_text,
)

if TYPE_CHECKING:
    from motord.bus.messages.topics import View

__all__ = ["cos", "isfinite", "nan", "rest_report", "sin"]  # for the expressions of the tree
UNMEASURED = 1e6
"""Variance of what wheels cannot measure: height, roll, pitch. Filters give it no weight."""
GYRO_ZERO_RAD_S = 0.35
"""Deviation of a gyro's zero about x and y: 20 deg/s. The MPU-6000/MPU-6050 Product Specification,
revision 3.4, section 6.1, allows an initial zero-rate output of 20 deg/s at 25 degrees Celsius and
a variation over temperature of 20 deg/s: both together are two deviations."""
NOT_MEASURED = (-1.0, *[0.0] * 8)
"""Covariance of what an Imu does not measure (sensor_msgs/Imu)."""
ERROR_UNKNOWN = (0.0,) * 9
"""Covariance of what is measured with an unknown error (sensor_msgs/Imu)."""
NOT_PUBLISHED = ("stale", "reversed")
"""States of an inertial sensor whose measurements must not be published."""
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """The names that a snapshot does not contain. REP-105 defines those of the frames."""

    robot: str
    joints: tuple[str, ...]
    odom_frame: str = "odom"
    base_frame: str = "base_link"

    def with_frames(self, prefix: str) -> Body:
        """Return a copy with the prefix before each frame name."""
        return replace(
            self, odom_frame=prefix + self.odom_frame, base_frame=prefix + self.base_frame
        )


class Commander(NamedTuple):
    """The source in command: its lease's owner, its priority, and why it is in command."""

    owner: str
    priority: int
    why: str


NOBODY = Commander(owner="", priority=0, why="")


class Level(enum.IntEnum):
    """Level of a diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class PowerSupply(enum.IntEnum):
    """Values of sensor_msgs/BatteryState.power_supply_status; health and technology are unknown to
    us."""

    UNKNOWN = 0
    CHARGING = 1
    DISCHARGING = 2


@dataclass(frozen=True, slots=True)
class KeyValue:
    """diagnostic_msgs/KeyValue."""

    key: str
    value: str


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """diagnostic_msgs/DiagnosticStatus."""

    level: Level
    name: str
    message: str
    hardware_id: str
    values: tuple[KeyValue, ...]


class Battery(NamedTuple):
    """Measurements of the battery; NaN: not measured. `current_a` flows into the battery."""

    stamp_ns: int
    voltage_v: float
    current_a: float = nan
    temperature_c: float = nan
    capacity_ah: float = nan
    cells: int = 0


def or_zero(value: float) -> float:
    """Return the value; zero if it was not measured."""
    return value if isfinite(value) else 0.0


def all_joints(now: Snapshot, body: Body) -> tuple[Sequence[str], Sequence[JointSnapshot]]:
    """Return names and joints. Raises ValueError if the daemon runs another robot file of this
    name."""
    names, joints = body.joints, now.joints
    if len(names) != len(joints):
        raise ValueError(f"{len(joints)} joints, and the robot file has {len(names)}")
    return names, joints


def with_position(now: Snapshot, body: Body) -> tuple[Sequence[str], Sequence[JointSnapshot]]:
    """Return names and joints that have fresh feedback and a position; a velocity may be NaN.
    Raises ValueError: see `all_joints`."""
    names, joints = all_joints(now, body)
    known = [
        not joint.stale and isfinite(joint.position_rad) and isfinite(joint.feedback_age_s)
        for joint in joints
    ]
    if all(known):
        return names, joints
    return tuple(compress(names, known)), tuple(compress(joints, known))


def newest_ns(now: Snapshot, joints: Sequence[JointSnapshot]) -> int:
    """Return the stamp of the newest feedback of these joints."""
    return now.stamp_ns - round(min([joint.feedback_age_s for joint in joints]) * _NS)


def yaw_variance(imu: ImuSnapshot) -> float:
    """Return the variance of the rate about z; zero: it is unknown before the gyro has a zero."""
    variance = imu.rate_variance_rad2_s2 + imu.bias_variance_rad2_s2
    return variance if isfinite(variance) else 0.0


def tilt_variance(rate_rad_s: float, imu: ImuSnapshot) -> float:
    """Return the variance of the rate about x or y, from which no zero is taken away: motord does
    not measure it, so it counts as GYRO_ZERO_RAD_S beside the noise about z. An axis that is not
    measured has UNMEASURED; zero: as `yaw_variance`."""
    if not isfinite(imu.rate_variance_rad2_s2):
        return 0.0
    known = imu.rate_variance_rad2_s2 + GYRO_ZERO_RAD_S**2
    return known if isfinite(rate_rad_s) else UNMEASURED


def battery_of(view: View) -> Battery | None:
    """Return [battery] of the robot file by the daemon's status; without a [battery] the lowest
    supply voltage that a fresh drive measures; None: nothing measures it. The motors' current is
    not the battery's, and stays NaN."""
    found = view.battery()
    if found is not None:
        if found["voltage_v"] is None:
            return None
        return Battery(
            stamp_ns=found["stamp_ns"],
            voltage_v=found["voltage_v"],
            current_a=_or_nan(found["current_a"]),
            temperature_c=_or_nan(found["temperature_c"]),
            capacity_ah=_or_nan(found["capacity_ah"]),
            cells=found["cells"] or 0,
        )
    now = view.snapshot
    measure = [
        joint
        for joint in now.joints
        if isfinite(joint.voltage_v) and isfinite(joint.feedback_age_s) and not joint.stale
    ]
    if not measure:
        return None
    return Battery(
        stamp_ns=newest_ns(now, measure), voltage_v=min([joint.voltage_v for joint in measure])
    )


def _or_nan(value: float | None) -> float:
    return nan if value is None else value


def power_supply_status(current_a: float) -> PowerSupply:
    """Return the status by the current into the battery."""
    if current_a == 0.0 or not isfinite(current_a):
        return PowerSupply.UNKNOWN
    return PowerSupply.CHARGING if current_a > 0.0 else PowerSupply.DISCHARGING


_BATTERY_LEVELS = {"normal": Level.OK, "warning": Level.WARN, "critical": Level.ERROR}


def diagnostics(view: View, body: Body) -> tuple[DiagnosticStatus, ...]:
    """Return the diagnostics of the base and each joint, and of the inertial sensor and the battery
    if there are such."""
    snapshot, battery = view.snapshot, view.battery()
    statuses = (_base_diagnostic(snapshot, body), *_joint_diagnostics(snapshot, body))
    if snapshot.imu is not None:
        statuses += (_imu_diagnostic(snapshot.imu, body),)
    if battery is not None:
        level, measured = _BATTERY_LEVELS.get(battery["state"], Level.STALE), dict(battery)
        state = measured.pop("state")
        measured.pop("stamp_ns", None)
        values = {key: _word(_or_nan(value)) for key, value in measured.items()}
        name = f"{body.robot}: battery"
        statuses += (DiagnosticStatus(level, name, state, body.robot, _pairs(values)),)
    return statuses


def _base_diagnostic(snapshot: Snapshot, body: Body) -> DiagnosticStatus:
    level, message = Level.OK, state_name(snapshot)
    if snapshot.odometry_degraded:
        level, message = Level.WARN, f"{message}; odometry is degraded"
    if snapshot.counter_coarse:
        coarse = ", ".join(joints_of(snapshot.counter_coarse, body.joints))
        level, message = Level.WARN, f"{message}; the counter of {coarse} has become coarse"
    if snapshot.faults:
        level, message = Level.ERROR, f"{message}: {', '.join(snapshot.faults)}"
    if snapshot.rest == Rest.UNKNOWN:
        unknown = rest_report(snapshot, body.joints)["rest_unknown_s"]
        level, message = Level.ERROR, f"{message}; {rest_text(snapshot.rest, unknown)}"
    values = {
        "state": state_name(snapshot),
        "armed": _word(snapshot.armed),
        "at_rest": _word(snapshot.at_rest),
        "rest": snapshot.rest,
        "faults": " ".join(snapshot.faults),
        "reasons": " ".join(snapshot.reasons),
        "saturation": _word(snapshot.saturation),
        "command_age_s": _word(snapshot.command_age_s),
    }
    return DiagnosticStatus(level, f"{body.robot}: base", message, body.robot, _pairs(values))


def _joint_diagnostics(snapshot: Snapshot, body: Body) -> Iterator[DiagnosticStatus]:
    for name, joint in zip(*all_joints(snapshot, body), strict=True):
        level, message = _joint_level(joint)
        values = {
            "enabled": "unknown" if joint.enabled is None else _word(joint.enabled),
            "drive_faults": f"0x{joint.drive_faults:x}",
            "feedback_age_s": _word(joint.feedback_age_s),
            "current_a": _word(joint.current_a),
            "voltage_v": _word(joint.voltage_v),
            "temperature_c": _word(joint.temperature_c),
            "jumps": str(joint.jumps),
        }
        title = f"{body.robot}: joint {name}"
        yield DiagnosticStatus(level, title, message, f"{body.robot}/{name}", _pairs(values))


_IMU_LEVELS = {"used": Level.OK, "unbiased": Level.WARN, "stale": Level.STALE}


def _imu_diagnostic(found: ImuSnapshot, body: Body) -> DiagnosticStatus:
    values = {
        "heading_by_gyro": _word(found.heading_by_gyro),
        "still": _word(found.still),
        "bias_rad_s": _word(found.bias_rad_s),
        "refused": str(found.refused),
    }
    level = _IMU_LEVELS.get(found.state, Level.ERROR)
    return DiagnosticStatus(level, f"{body.robot}: imu", found.state, body.robot, _pairs(values))


def _joint_level(joint: JointSnapshot) -> tuple[Level, str]:
    if joint.stale:
        return Level.STALE, "no feedback"
    if joint.drive_faults:
        return Level.ERROR, f"the drive reports fault 0x{joint.drive_faults:x}"
    return Level.OK, "ok"


def _word(value: bool | float) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def _pairs(values: Mapping[str, str]) -> tuple[KeyValue, ...]:
    return tuple(KeyValue(key, value) for key, value in values.items())


def state_name(snapshot: Snapshot) -> str:
    """Return the name of the state; a number that this version does not know is shown as it is."""
    number = snapshot.machine_state
    return STATES[number] if 0 <= number < len(STATES) else f"state {number}"
