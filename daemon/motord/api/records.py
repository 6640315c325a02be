# SPDX-License-Identifier: Apache-2.0
"""What the core shows after a tick, as plain Python values. csrc/build_api.py writes this file from
the structures of csrc/api: the state page is decoded by these names, in their order."""

from __future__ import annotations

from dataclasses import dataclass

I64 = int
U64 = int
U32 = int
Doubles3 = tuple[float, ...]
Doubles6 = tuple[float, ...]
Doubles8 = tuple[float, ...]
Stamps8 = tuple[int, ...]
Reasons = tuple[str, ...]
Faults = tuple[str, ...]
FirstFault = str
DeratedBy = str
GyroState = str
RestWord = str
PAGE_LAYOUT_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSnapshot:
    """State of one joint. NaN, None: not reported by its drive."""

    position_rad: float  # sum of all counted turns since start, never jumps
    velocity_rad_s: float  # measured, NaN before the first measure
    setpoint_rad_s: float
    duty: float
    current_a: float
    voltage_v: float
    temperature_c: float
    feedback_age_s: float  # INFINITY: never received
    drive_faults: U32  # as received last
    enabled: bool | None
    stale: bool  # older than feedback_timeout_s
    jumps: U32  # counter jumps refused so far


@dataclass(frozen=True, slots=True, kw_only=True)
class JointStatus:
    """A JointSnapshot, as the answer of `status` has it."""

    position_rad: float | None = None  # sum of all counted turns since start, never jumps
    velocity_rad_s: float | None = None  # measured, NaN before the first measure
    setpoint_rad_s: float | None = None
    duty: float | None = None
    current_a: float | None = None
    voltage_v: float | None = None
    temperature_c: float | None = None
    feedback_age_s: float | None = None  # INFINITY: never received
    drive_faults: int = 0  # as received last
    enabled: bool | None = None
    stale: bool = False  # older than feedback_timeout_s
    jumps: int = 0  # counter jumps refused so far


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSnapshot:
    """IMU in the base's x, y, z. NaN: not measured, or unknown yet."""

    stamp_ns: I64  # stamp of the newest sample; 0: no sample
    angular_rad_s: Doubles3  # about z without its zero-rate offset, once that is known
    acceleration_m_s2: Doubles3
    bias_rad_s: float  # zero-rate offset about z
    bias_variance_rad2_s2: float
    rate_variance_rad2_s2: float  # variance of a sample about z
    state: GyroState
    heading_by_gyro: bool  # the newest turn in the pose is by the gyro, 0: by the wheels
    still: bool  # the base stands still, by wheels and gyro: the heading is held
    refused: U32  # samples so far that were no numbers, off the scale or out of order


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuStatus:
    """An ImuSnapshot, as the answer of `status` has it."""

    stamp_ns: int = 0  # stamp of the newest sample; 0: no sample
    angular_rad_s: tuple[float | None, ...] = ()  # about z without its zero-rate offset, once that
    # is known
    acceleration_m_s2: tuple[float | None, ...] = ()
    bias_rad_s: float | None = None  # zero-rate offset about z
    bias_variance_rad2_s2: float | None = None
    rate_variance_rad2_s2: float | None = None  # variance of a sample about z
    state: str = ""
    heading_by_gyro: bool = False  # the newest turn in the pose is by the gyro, 0: by the wheels
    still: bool = False  # the base stands still, by wheels and gyro: the heading is held
    refused: int = 0  # samples so far that were no numbers, off the scale or out of order


@dataclass(frozen=True, slots=True, kw_only=True)
class DoubtSnapshot:
    """Why a fault says that the feedback is not believed."""

    since_ns: I64
    setpoint_rad_s: float
    measured_rad_s: float  # measured by the counter if the joint has one, smoothed
    reported_rad_s: float  # the drive's own measured value, as it came; NaN: none
    fault: FirstFault
    joint: U32


@dataclass(frozen=True, slots=True, kw_only=True)
class DeratingSnapshot:
    """The derating of the joint that slows the base most."""

    since_ns: I64  # 0: no joint derates the base
    factor: float  # factor of the base's speed limits
    joint: U32
    by: DeratedBy


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedLoopSnapshot:
    """One wheel's speed loop: torque in N m, or duty."""

    output_u: float  # 0 without a loop
    integral_u: float  # part of the output from the integral


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainSnapshot:
    """State of the robot as a whole, without its sub-structures."""

    stamp_ns: I64  # this tick
    tick: U64
    machine_state: U32  # as in core_control
    owner: U32
    reasons: Reasons
    faults: Faults  # latched
    armed: bool  # the core itself is armed
    enabled: bool  # the drives are to have power
    at_rest: bool  # set-points are zero and every wheel was seen slower than rest_velocity_rad_s;
    # 0: it turns, or that is unknown: see rest_shown
    odometry_degraded: bool  # a wheel is stale, or has no counter
    odometry_epoch: U32  # odometry resets so far
    dt_s: float
    command_age_s: float  # INFINITY: never
    wanted_linear_m_s: float  # the command as it came in, 0 when stale or not finite
    wanted_angular_rad_s: float
    setpoint_linear_m_s: float  # after limits and saturation
    setpoint_angular_rad_s: float
    saturation: float  # common factor of all wheels; 1: no saturation
    odometry_stamp_ns: I64  # stamp of the newest feedback that is in the pose
    x_m: float
    y_m: float
    heading_rad: float  # -pi..pi
    distance_m: float  # travelled, in any direction; never falls
    turned_rad: float  # sum of |turn|, never falls
    linear_m_s: float  # measured; NaN: the wheels with fresh feedback do not determine it
    angular_rad_s: float
    pose_covariance: Doubles6  # xx, xy, xh, yy, yh, hh in m2, m rad, rad2
    twist_covariance: Doubles3  # vv, vw, ww; NaN: as linear_m_s


@dataclass(frozen=True, slots=True, kw_only=True)
class LateralSnapshot(PlainSnapshot):
    """Adds the values of motion sideways."""

    wanted_lateral_m_s: float  # the command as it came in, to the left; 0 when stale or not finite
    setpoint_lateral_m_s: float
    lateral_m_s: float  # measured, positive to the left
    slip_m_s: float  # root mean square of the rims' speeds that no motion of the base explains
    lateral_covariance: Doubles3  # of the measured twist: vx vy, vy vy, vy w in m2/s2, m2/s2, m
    # rad/s2; NaN: as linear_m_s


@dataclass(frozen=True, slots=True, kw_only=True)
class SteeringSnapshot(LateralSnapshot):
    """Adds joints that take positions."""

    position_setpoints_rad: Doubles8  # NaN: no set-point
    misaligned_rad: float  # greatest angle between a wheel and its wanted direction; INFINITY: not
    # known yet
    position_joints: U32  # bit n: joint n takes positions, and its position_rad is its angle
    position_unknown: U32  # bit n: the position of joint n is unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class RestSnapshot(SteeringSnapshot):
    """Adds whether the robot rests."""

    rest_unknown_since_ns: Stamps8  # tick since which it is unknown whether joint n turns; 0: it is
    # known
    rest: RestWord
    rest_unmeasured: U32  # bit n: nothing measures joint n: its set-point counts


@dataclass(frozen=True, slots=True, kw_only=True)
class CountersSnapshot(RestSnapshot):
    """Adds what is wrong with counters."""

    counter_coarse: U32  # bit n: joint n's counter is made of a floating-point number, and has gone
    # so far that one of its steps is more than a wheel at rest may turn in 0.2 s: its drive has to
    # be restarted
    counter_distrusted: U32  # bit n: the odometry leaves joint n's counter out until the reset: see
    # FAULT_IMPLAUSIBLE_FEEDBACK
