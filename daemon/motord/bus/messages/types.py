# SPDX-License-Identifier: Apache-2.0
"""The messages that buses carry, as plain values. Nested and named as the ROS 2 types are, field by
field and in their order (common_interfaces, geometry2; units by REP-103), so that an adapter moves
bytes and knows no meaning. Our own types, at the end, wear their units in their names.

NaN is what was not measured, as sensor_msgs has it.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Time:
    """builtin_interfaces/Time: wall time since 1970."""

    sec: int
    nanosec: int


@dataclass(frozen=True, slots=True)
class Header:
    """std_msgs/Header."""

    stamp: Time
    frame_id: str


@dataclass(frozen=True, slots=True)
class Vector3:
    """geometry_msgs/Vector3 and Point: m, m/s or rad/s by its place."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class Quaternion:
    """geometry_msgs/Quaternion."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


@dataclass(frozen=True, slots=True)
class Pose:
    """geometry_msgs/Pose: m."""

    position: Vector3
    orientation: Quaternion


@dataclass(frozen=True, slots=True)
class PoseWithCovariance:
    """geometry_msgs/PoseWithCovariance: x, y, z, about x, about y, about z; row by row."""

    pose: Pose
    covariance: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Twist:
    """geometry_msgs/Twist: m/s, rad/s."""

    linear: Vector3
    angular: Vector3


@dataclass(frozen=True, slots=True)
class TwistWithCovariance:
    """geometry_msgs/TwistWithCovariance."""

    twist: Twist
    covariance: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Odometry:
    """nav_msgs/Odometry: pose in the header's frame, twist in the child's."""

    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass(frozen=True, slots=True)
class Transform:
    """geometry_msgs/Transform: m."""

    translation: Vector3
    rotation: Quaternion


@dataclass(frozen=True, slots=True)
class TransformStamped:
    """geometry_msgs/TransformStamped."""

    header: Header
    child_frame_id: str
    transform: Transform


@dataclass(frozen=True, slots=True)
class TFMessage:
    """tf2_msgs/TFMessage."""

    transforms: tuple[TransformStamped, ...]


@dataclass(frozen=True, slots=True)
class JointState:
    """sensor_msgs/JointState: rad, rad/s; no effort is measured."""

    header: Header
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Imu:
    """sensor_msgs/Imu: rad/s, m/s², in the header's frame. A covariance that begins with -1 belongs
    to what is not measured, one of zeros to what is measured with an unknown error."""

    header: Header
    orientation: Quaternion
    orientation_covariance: tuple[float, ...]
    angular_velocity: Vector3
    angular_velocity_covariance: tuple[float, ...]
    linear_acceleration: Vector3
    linear_acceleration_covariance: tuple[float, ...]


class PowerSupply(enum.IntEnum):
    """Of sensor_msgs/BatteryState: status; health and technology are unknown to us."""

    UNKNOWN = 0
    CHARGING = 1
    DISCHARGING = 2


@dataclass(frozen=True, slots=True)
class BatteryState:
    """sensor_msgs/BatteryState: V, °C, A, Ah, Ah, Ah, 0 to 1."""

    header: Header
    voltage: float
    temperature: float
    current: float
    charge: float
    capacity: float
    design_capacity: float
    percentage: float
    power_supply_status: int
    power_supply_health: int
    power_supply_technology: int
    present: bool
    cell_voltage: tuple[float, ...]
    cell_temperature: tuple[float, ...]
    location: str
    serial_number: str


class Level(enum.IntEnum):
    """Of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


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


@dataclass(frozen=True, slots=True)
class DiagnosticArray:
    """diagnostic_msgs/DiagnosticArray."""

    header: Header
    status: tuple[DiagnosticStatus, ...]


@dataclass(frozen=True, slots=True)
class MotorStatus:
    """motord_msgs/MotorStatus: the state machine, who commands, and each wheel; the tuples from
    `name` on have one place for each joint."""

    header: Header
    state: str
    armed: bool
    at_rest: bool
    faults: tuple[str, ...]
    """What is latched."""
    why: tuple[str, ...]
    """What led to it, in words: who asked for an emergency stop, which drive failed."""
    reasons: tuple[str, ...]
    """Why the set-point is not what was asked for."""
    commander: str
    """Owner of the lease in command; empty: nobody."""
    commander_priority: int
    commander_why: str
    """Why that one is in command, in words."""
    command_age_s: float
    setpoint_linear_m_s: float
    setpoint_angular_rad_s: float
    name: tuple[str, ...]
    setpoint_rad_s: tuple[float, ...]
    duty: tuple[float, ...]
    current_a: tuple[float, ...]
    voltage_v: tuple[float, ...]
    temperature_c: tuple[float, ...]
    feedback_age_s: tuple[float, ...]
    drive_faults: tuple[int, ...]
    stale: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class LoopStatistics:
    """motord_msgs/LoopStatistics: the real-time loop since its start."""

    header: Header
    rate_hz: float
    policy: str
    ticks: int
    overruns: int
    page_faults: int
    lateness_p50_us: float
    lateness_p99_us: float
    lateness_p99_9_us: float
    lateness_max_us: float
    step_p50_ns: float
    step_p99_ns: float
    step_p99_9_ns: float
    step_max_ns: float
