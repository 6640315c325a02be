# SPDX-License-Identifier: Apache-2.0
"""From a snapshot to messages: the one place where it is said what a field of it means on a bus.

Pure functions. Frames are those of REP-105; the stamp is the sample's own moment, as wall time.
A message that would be wrong is none: a pose that is not finite has no odometry.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from motord.api.snapshot import STATES, ImuSnapshot, JointSnapshot, Snapshot
from motord.bus.messages.types import (
    BatteryState,
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    Imu,
    JointState,
    KeyValue,
    Level,
    LoopStatistics,
    MotorStatus,
    Odometry,
    Pose,
    PoseWithCovariance,
    PowerSupply,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)

UNMEASURED = 1e6
"""Variance of what wheels cannot tell: height, roll, pitch. Filters give it no weight."""
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """What a snapshot does not say of its robot: names. REP-105 has those of the frames."""

    robot: str
    joints: tuple[str, ...]
    odom_frame: str = "odom"
    base_frame: str = "base_link"

    def with_frames(self, prefix: str) -> Body:
        """The same, with the prefix before each frame name."""
        return replace(
            self, odom_frame=prefix + self.odom_frame, base_frame=prefix + self.base_frame
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Commander:
    """Who is in command: a lease's owner, its priority, and why it is that one."""

    owner: str
    priority: int
    why: str


def wall_time(moment_ns: int, wall_offset_ns: int) -> Time:
    """A moment of CLOCK_MONOTONIC; the offset is CLOCK_REALTIME less CLOCK_MONOTONIC, now."""
    sec, nanosec = divmod(moment_ns + wall_offset_ns, _NS)
    return Time(sec, nanosec)


def odometry(snapshot: Snapshot, body: Body, wall_offset_ns: int) -> Odometry | None:
    """nav_msgs/Odometry, of the newest feedback that is in the pose. None: no feedback yet, or a
    number in it that is not finite."""
    numbers = (snapshot.linear_m_s, snapshot.angular_rad_s)
    if not _has_pose(snapshot) or not all(map(math.isfinite, numbers)):
        return None
    stamp = wall_time(snapshot.odometry_stamp_ns, wall_offset_ns)
    position = Vector3(snapshot.x_m, snapshot.y_m)
    twist = Twist(Vector3(snapshot.linear_m_s), Vector3(z=snapshot.angular_rad_s))
    return Odometry(
        Header(stamp, body.odom_frame),
        body.base_frame,
        PoseWithCovariance(
            Pose(position, about_z(snapshot.heading_rad)), pose_covariance(snapshot.pose_covariance)
        ),
        TwistWithCovariance(twist, twist_covariance(snapshot.twist_covariance)),
    )


def transforms(snapshot: Snapshot, body: Body, wall_offset_ns: int) -> TFMessage | None:
    """tf2_msgs/TFMessage: the base in the odometry's frame. None as for `odometry`."""
    if not _has_pose(snapshot):
        return None
    stamp = wall_time(snapshot.odometry_stamp_ns, wall_offset_ns)
    place = Vector3(snapshot.x_m, snapshot.y_m)
    return TFMessage(
        (
            TransformStamped(
                Header(stamp, body.odom_frame),
                body.base_frame,
                Transform(place, about_z(snapshot.heading_rad)),
            ),
        )
    )


def _has_pose(snapshot: Snapshot) -> bool:
    numbers = (snapshot.x_m, snapshot.y_m, snapshot.heading_rad)
    return snapshot.odometry_stamp_ns != 0 and all(map(math.isfinite, numbers))


def about_z(angle_rad: float) -> Quaternion:
    """A turn about the vertical axis."""
    return Quaternion(z=math.sin(angle_rad / 2.0), w=math.cos(angle_rad / 2.0))


def pose_covariance(planar: tuple[float, ...]) -> tuple[float, ...]:
    """6 x 6 from xx, xy, xh, yy, yh, hh."""
    xx, xy, xh, yy, yh, hh = planar
    matrix = [0.0] * 36
    matrix[0], matrix[1], matrix[5] = xx, xy, xh
    matrix[6], matrix[7], matrix[11] = xy, yy, yh
    matrix[30], matrix[31], matrix[35] = xh, yh, hh
    matrix[14] = matrix[21] = matrix[28] = UNMEASURED
    return tuple(matrix)


def twist_covariance(planar: tuple[float, ...]) -> tuple[float, ...]:
    """6 x 6 from vv, vw, ww. Sideways the base is at rest as surely as its speed is known."""
    vv, vw, ww = planar
    matrix = [0.0] * 36
    matrix[0], matrix[5], matrix[7], matrix[30], matrix[35] = vv, vw, vv, vw, ww
    matrix[14] = matrix[21] = matrix[28] = UNMEASURED
    return tuple(matrix)


def joint_state(snapshot: Snapshot, body: Body, wall_offset_ns: int) -> JointState | None:
    """sensor_msgs/JointState of the joints that have been heard and have a position; a velocity may
    be NaN. Stamped with the oldest feedback among them. None: there is no such joint."""
    heard = [
        (name, joint)
        for name, joint in zip(body.joints, snapshot.joints, strict=True)
        if math.isfinite(joint.position_rad) and math.isfinite(joint.feedback_age_s)
    ]
    if not heard:
        return None
    oldest_s = max(joint.feedback_age_s for _, joint in heard)
    return JointState(
        Header(wall_time(snapshot.stamp_ns - round(oldest_s * _NS), wall_offset_ns), ""),
        name=tuple(name for name, _ in heard),
        position=tuple(joint.position_rad for _, joint in heard),
        velocity=tuple(joint.velocity_rad_s for _, joint in heard),
    )


NOT_MEASURED = (-1.0, *[0.0] * 8)
"""As the covariance of what an Imu does not say."""
NOT_TOLD = ("stale", "reversed")
"""States of a sensor that nobody should believe."""
_ERROR_UNKNOWN = (0.0,) * 9


def imu(snapshot: Snapshot, body: Body, wall_offset_ns: int) -> Imu | None:
    """sensor_msgs/Imu, of the newest sample, turned into the base's axes. An axis that is not
    measured has the variance UNMEASURED. None: no sensor, one that turns
    against the wheels, or its last good sample is old."""
    found = snapshot.imu
    if found is None or found.state in NOT_TOLD or not math.isfinite(found.angular_rad_s[2]):
        return None
    variances = (*[math.nan] * 2, found.rate_variance_rad2_s2 + found.bias_variance_rad2_s2)
    felt = found.acceleration_m_s2
    feels = all(map(math.isfinite, felt))
    return Imu(
        header=Header(wall_time(found.stamp_ns, wall_offset_ns), body.base_frame),
        orientation=Quaternion(),
        orientation_covariance=NOT_MEASURED,
        angular_velocity=Vector3(*(_or_zero(rate) for rate in found.angular_rad_s)),
        angular_velocity_covariance=_rate_covariance(found.angular_rad_s, variances),
        linear_acceleration=Vector3(*felt) if feels else Vector3(),
        linear_acceleration_covariance=_ERROR_UNKNOWN if feels else NOT_MEASURED,
    )


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _rate_covariance(rates: tuple[float, ...], variances: tuple[float, ...]) -> tuple[float, ...]:
    """What is measured without a known error is taken for as good as the yaw rate; before the gyro
    has a zero, nobody knows how good that is."""
    yaw_variance = variances[2]
    if not math.isfinite(yaw_variance):
        return _ERROR_UNKNOWN
    matrix = [0.0] * 9
    for axis, rate in enumerate(rates):
        matrix[4 * axis] = yaw_variance if math.isfinite(rate) else UNMEASURED
    return tuple(matrix)


def battery_state(
    snapshot: Snapshot, wall_offset_ns: int, battery: Mapping[str, Any] | None = None
) -> BatteryState | None:
    """sensor_msgs/BatteryState: `battery` of the daemon's `status`; without one the lowest supply
    voltage that a fresh drive measures. None: nothing does. What the battery delivers is not the
    motors' current, and stays NaN."""
    if battery is not None:
        if battery["voltage_v"] is None:
            return None
        return _battery_message(
            wall_time(snapshot.stamp_ns, wall_offset_ns),
            battery["voltage_v"],
            current_a=_or_nan(battery["current_a"]),
            temperature_c=_or_nan(battery["temperature_c"]),
            capacity_ah=_or_nan(battery["capacity_ah"]),
            cells=battery["cells"] or 0,
        )
    volts = [
        joint.voltage_v
        for joint in snapshot.joints
        if math.isfinite(joint.voltage_v) and not joint.stale
    ]
    if not volts:
        return None
    return _battery_message(wall_time(snapshot.stamp_ns, wall_offset_ns), min(volts))


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def power_supply_status(current_a: float | None) -> PowerSupply:
    """By the current into the battery."""
    if current_a is None or current_a == 0.0 or not math.isfinite(current_a):
        return PowerSupply.UNKNOWN
    return PowerSupply.CHARGING if current_a > 0.0 else PowerSupply.DISCHARGING


def _battery_message(
    stamp: Time,
    voltage_v: float,
    *,
    current_a: float = math.nan,
    temperature_c: float = math.nan,
    capacity_ah: float = math.nan,
    cells: int = 0,
) -> BatteryState:
    """Cells that nobody measures one by one are NaN each, as the message's definition has it."""
    return BatteryState(
        header=Header(stamp, ""),
        voltage=voltage_v,
        temperature=temperature_c,
        current=current_a,
        charge=math.nan,
        capacity=math.nan,
        design_capacity=capacity_ah,
        percentage=math.nan,
        power_supply_status=power_supply_status(current_a),
        power_supply_health=PowerSupply.UNKNOWN,
        power_supply_technology=PowerSupply.UNKNOWN,
        present=True,
        cell_voltage=(math.nan,) * cells,
        cell_temperature=(),
        location="",
        serial_number="",
    )


_BATTERY_LEVELS = {"normal": Level.OK, "warning": Level.WARN, "critical": Level.ERROR}


def diagnostics(
    snapshot: Snapshot,
    body: Body,
    wall_offset_ns: int,
    battery: Mapping[str, Any] | None = None,
) -> DiagnosticArray:
    """diagnostic_msgs/DiagnosticArray: the base, each joint, the inertial sensor and the battery
    where there are such."""
    statuses = (_base_diagnostic(snapshot, body), *_joint_diagnostics(snapshot, body))
    if snapshot.imu is not None:
        statuses += (_imu_diagnostic(snapshot.imu, body),)
    if battery is not None:
        level, measured = _BATTERY_LEVELS.get(battery["state"], Level.STALE), dict(battery)
        state = measured.pop("state")
        values = {key: _word(_or_nan(value)) for key, value in measured.items()}
        name = f"{body.robot}: battery"
        statuses += (DiagnosticStatus(level, name, state, body.robot, _pairs(values)),)
    return DiagnosticArray(Header(wall_time(snapshot.stamp_ns, wall_offset_ns), ""), statuses)


def _base_diagnostic(snapshot: Snapshot, body: Body) -> DiagnosticStatus:
    level, message = Level.OK, state_name(snapshot)
    if snapshot.odometry_degraded:
        level, message = Level.WARN, f"{message}; odometry is degraded"
    if snapshot.faults:
        level, message = Level.ERROR, f"{message}: {', '.join(snapshot.faults)}"
    values = {
        "state": state_name(snapshot),
        "armed": _word(snapshot.armed),
        "at_rest": _word(snapshot.at_rest),
        "faults": " ".join(snapshot.faults),
        "reasons": " ".join(snapshot.reasons),
        "saturation": _word(snapshot.saturation),
        "command_age_s": _word(snapshot.command_age_s),
    }
    return DiagnosticStatus(level, f"{body.robot}: base", message, body.robot, _pairs(values))


def _joint_diagnostics(snapshot: Snapshot, body: Body) -> Iterator[DiagnosticStatus]:
    for name, joint in zip(body.joints, snapshot.joints, strict=True):
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
        said = f"{body.robot}: joint {name}"
        yield DiagnosticStatus(level, said, message, f"{body.robot}/{name}", _pairs(values))


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
        return Level.STALE, "not heard"
    if joint.drive_faults:
        return Level.ERROR, f"the drive reports fault 0x{joint.drive_faults:x}"
    return Level.OK, "ok"


def _word(value: bool | float) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def _pairs(values: Mapping[str, str]) -> tuple[KeyValue, ...]:
    return tuple(KeyValue(key, value) for key, value in values.items())


def state_name(snapshot: Snapshot) -> str:
    """The state machine's word; a number that this version does not know is shown as it is."""
    number = snapshot.machine_state
    return STATES[number] if 0 <= number < len(STATES) else f"state {number}"


def motor_status(
    snapshot: Snapshot,
    body: Body,
    wall_offset_ns: int,
    commander: Commander | None = None,
    why: tuple[str, ...] = (),
) -> MotorStatus:
    """Our own: all that a snapshot says of drives and command. `commander` is the daemon's word on
    lease number `snapshot.owner`; None: nobody, or not known yet. `why`: its word on the faults."""
    joints = snapshot.joints
    return MotorStatus(
        header=Header(wall_time(snapshot.stamp_ns, wall_offset_ns), body.base_frame),
        state=state_name(snapshot),
        armed=snapshot.armed,
        at_rest=snapshot.at_rest,
        faults=snapshot.faults,
        why=why,
        reasons=snapshot.reasons,
        commander=commander.owner if commander else "",
        commander_priority=commander.priority if commander else 0,
        commander_why=commander.why if commander else "",
        command_age_s=snapshot.command_age_s,
        setpoint_linear_m_s=snapshot.setpoint_linear_m_s,
        setpoint_angular_rad_s=snapshot.setpoint_angular_rad_s,
        name=body.joints,
        setpoint_rad_s=tuple(joint.setpoint_rad_s for joint in joints),
        duty=tuple(joint.duty for joint in joints),
        current_a=tuple(joint.current_a for joint in joints),
        voltage_v=tuple(joint.voltage_v for joint in joints),
        temperature_c=tuple(joint.temperature_c for joint in joints),
        feedback_age_s=tuple(joint.feedback_age_s for joint in joints),
        drive_faults=tuple(joint.drive_faults for joint in joints),
        stale=tuple(joint.stale for joint in joints),
    )


def loop_statistics(loop: Mapping[str, Any], moment_ns: int, wall_offset_ns: int) -> LoopStatistics:
    """Our own, from `loop` of the daemon's `status`, asked for at that moment."""
    late, step = loop["lateness_us"], loop["step_ns"]
    return LoopStatistics(
        header=Header(wall_time(moment_ns, wall_offset_ns), ""),
        rate_hz=loop["rate_hz"],
        policy=loop["policy"],
        ticks=loop["ticks"],
        overruns=loop["overruns"],
        page_faults=loop["page_faults"],
        lateness_p50_us=late["p50"],
        lateness_p99_us=late["p99"],
        lateness_p99_9_us=late["p99_9"],
        lateness_max_us=late["max"],
        step_p50_ns=step["p50"],
        step_p99_ns=step["p99"],
        step_p99_9_ns=step["p99_9"],
        step_max_ns=step["max"],
    )
