# SPDX-License-Identifier: Apache-2.0
"""Settings of the core, the loop and the lines, made from the robot file. Pure."""

from __future__ import annotations

from motord.config.sections.bases import JointsBase, wheel_modules, wheel_row
from motord.config.sections.imu import Imu
from motord.config.sections.joint.derating import PAIRS, Derating
from motord.config.sections.joint.feedback import FeedbackChecks
from motord.config.sections.joint.limits import JointLimits
from motord.config.sections.joint.speed_loop import DUTY_GAINS, SpeedLoop
from motord.config.sections.joint.wheels import (
    Profiles,
    counter_bits,
    counter_mantissa_bits,
    gains_of,
    rad_per_count,
    reference_of,
    reports_motion,
    takes_duty,
    takes_position,
    takes_torque,
    velocity_range_rad_s,
    working_speed_rad_s,
)
from motord.config.sections.limits import Limits
from motord.config.sections.model import Joint, Robot
from motord.config.wiring import line_specs
from motord.realtime import loop as rt
from motord.realtime.types import (
    DeratingConfig,
    DeratingRange,
    GuardConfig,
    PlausibleConfig,
    PositionConfig,
    SpeedLoopConfig,
    SpeedLoopGains,
    WheelModule,
)
from motord_hal.drives.profile import DriveProfile

__all__ = ["core_config", "base_limits", "line_specs", "loop_settings"]

_NOTIFY_HZ = 50.0
"""How often asyncio looks at the state when no publisher needs it more often."""
_SLOW_PART = 0.02
"""Part of a wheel's working speed: a slower wheel counts as standing."""
_APART_PART = 0.1
"""Part of the working speed by which counter and reported velocity may differ (filter,
rounding)."""
_PROGRESS_PART = 0.01
"""Part of the working speed: each such step nearer to the set-point shows a drive that is only
slow."""
_DUTY_THAT_TURNS = 0.4
"""Duty at which the dead band of a motor and its load has ended; its size is unknown."""
_UNSURE_COUNTS_PER_S = 20.0
"""Rate of four counts when speeds are smoothed over 0.2 s (csrc/core/plausible.c)."""
_STALL_COUNTS = 8.0
"""How many counts have to be missing before an encoder counts as standing."""


def loop_settings(
    robot: Robot,
    command_fds: tuple[int, ...] = (),
    guard: GuardConfig | None = None,
    stop_fd: int = -1,
) -> rt.LoopSettings:
    """Return the settings of the loop's thread."""
    rates = (publish.rate_hz for publish in robot.publish.values())
    return rt.LoopSettings(
        rate_hz=robot.loop.rate_hz,
        priority=robot.loop.priority,
        cpu=robot.loop.cpu,
        notify_hz=min(max(_NOTIFY_HZ, *rates, 0.0), robot.loop.rate_hz),
        lock_memory=robot.loop.lock_memory,
        hold_dma_latency=robot.loop.hold_dma_latency,
        command_fds=command_fds,
        stop_fd=stop_fd,
        guard=guard,
    )


def core_config(robot: Robot, profiles: Profiles) -> rt.CoreConfig:
    """Return the core's config, joints in the file's order."""
    safety, modules = robot.safety, _modules(robot)
    return {
        "joint_count": len(robot.joint),
        "limits": base_limits(robot.limits),
        "command_timeout_s": safety.command_timeout_s,
        "feedback_timeout_s": safety.feedback_timeout_s,
        "heartbeat_timeout_s": safety.heartbeat_timeout_s,
        "rest_velocity_rad_s": safety.rest_velocity_rad_s,
        "on_timeout": rt.StopAction[safety.on_timeout.upper()],
        "on_fault": rt.StopAction[safety.on_fault.upper()],
        "on_estop": rt.StopAction[safety.on_estop.upper()],
        "distance_variance_m2_per_m": robot.odometry.distance_variance_m2_per_m,
        "turn_variance_rad2_per_rad": robot.odometry.turn_variance_rad2_per_rad,
        "pose_variance_floor_m2": robot.odometry.pose_variance_floor_m2,
        "heading_variance_floor_rad2": robot.odometry.heading_variance_floor_rad2,
        "twist_variance_floor_m2_s2": robot.odometry.twist_variance_floor_m2_s2,
        "twist_variance_floor_rad2_s2": robot.odometry.twist_variance_floor_rad2_s2,
        "gyro": _gyro(robot.imu),
        "module_count": len(modules),
        "module": modules,
        "independent": int(isinstance(robot.base, JointsBase)),
        "joint": [_joint(robot, name, profiles) for name in robot.joint],
    }


def _modules(robot: Robot) -> list[WheelModule]:
    number = {name: place for place, name in enumerate(robot.joint, 1)}
    return [
        {
            "x_m": module.x_m,
            "y_m": module.y_m,
            "angle_rad": 0.0,
            "steering": number[module.steering[0]] if module.steering else 0,
            "traction": number[module.traction[0]] if module.traction else 0,
        }
        for module in wheel_modules(robot.base, robot.joint)
    ]


def _position(joint: Joint, profile: DriveProfile, checks: FeedbackChecks) -> PositionConfig:
    """Return the settings of a joint that takes positions; `used` is 0 for any other joint.
    `zero_count` is what the counter shows at the joint's zero; rad_per_count includes gear and
    mounting."""
    if not takes_position(joint, profile):
        return {"used": 0}
    bits = counter_bits(joint, profile)
    return {
        "used": 1,
        "reference": reference_of(joint, profile),
        "zero_count": joint.zero_count % (1 << bits) if bits else 0,
        "position_min_rad": joint.position_min_rad or 0.0,
        "position_max_rad": joint.position_max_rad or 0.0,
        "velocity_rad_s": velocity_range_rad_s(joint, profile)[1],
        "acceleration_rad_s2": joint.acceleration_max_rad_s2,
        "following_rad": checks.position_following_rad,
        "following_s": checks.position_following_s,
    }


def _gyro(imu: Imu | None) -> rt.GyroConfig:
    if imu is None:
        return {"used": 0}
    return {
        "used": 1,
        "timeout_s": imu.timeout_s,
        "bias_max_rad_s": imu.bias_max_rad_s,
        "still_variance_rad2_s2": imu.still_deviation_rad_s**2,
        "heading_variance_rad2_per_s": imu.heading_variance_rad2_per_s,
        "turn_variance_rad2_per_rad": imu.turn_variance_rad2_per_rad,
    }


def base_limits(limits: Limits) -> rt.BaseLimits:
    """Return [limits] in the form of the core."""
    return {
        "linear": {
            "velocity_u_s": limits.linear_m_s,
            "acceleration_u_s2": limits.linear_m_s2,
            "deceleration_u_s2": limits.linear_deceleration_m_s2,
            "jerk_u_s3": limits.linear_m_s3,
        },
        "angular": {
            "velocity_u_s": limits.angular_rad_s,
            "acceleration_u_s2": limits.angular_rad_s2,
            "deceleration_u_s2": limits.angular_deceleration_rad_s2,
            "jerk_u_s3": limits.angular_rad_s3,
        },
        "lateral": {
            "velocity_u_s": limits.lateral_m_s,
            "acceleration_u_s2": limits.lateral_m_s2,
            "deceleration_u_s2": limits.lateral_deceleration_m_s2,
            "jerk_u_s3": limits.lateral_m_s3,
        },
    }


def _joint(robot: Robot, name: str, profiles: Profiles) -> rt.JointConfig:
    joint = robot.joint[name]
    profile = profiles[joint.drive]
    backward_rad_s, forward_rad_s = velocity_range_rad_s(joint, profile)
    row = wheel_row(robot.base, joint)
    return {
        "row": {"x": row.x, "y": row.y, "lever_m": row.lever_m},
        # the core needs a radius for every joint; without a base nothing depends on it
        "wheel_radius_m": robot.wheel_radius_m(name) or 1.0,
        "velocity_min_rad_s": backward_rad_s,
        "velocity_max_rad_s": forward_rad_s,
        "rad_per_count": rad_per_count(joint, profile),
        "counter_bits": counter_bits(joint, profile),
        "line": list(robot.line).index(joint.line),
        "unmeasured": int(not reports_motion(robot, name, profile)),
        "counter_mantissa_bits": counter_mantissa_bits(joint, profile),
        "pwm": _pwm(joint, profile, forward_rad_s, reversible=backward_rad_s < 0),
        "speed_loop": _speed_loop(joint, profile, reversible=backward_rad_s < 0),
        "plausible": {} if takes_position(joint, profile) else _plausible(robot, name, profile),
        "derating": _derating(joint.derating or Derating()),
        "position": _position(joint, profile, robot.safety.feedback),
        "own": joint_limits(JointLimits.of(joint)),
    }


def joint_limits(limits: JointLimits) -> rt.AxisLimits:
    """Return the limits of a joint without a base; the core reads those of no other joint."""
    return {
        "velocity_u_s": limits.velocity_max_rad_s,
        "acceleration_u_s2": limits.acceleration_max_rad_s2,
        "deceleration_u_s2": limits.deceleration_max_rad_s2,
        "jerk_u_s3": limits.jerk_max_rad_s3,
    }


def _plausible(robot: Robot, name: str, profile: DriveProfile) -> PlausibleConfig:
    """Return [safety.feedback] for one wheel. A coarse encoder widens the limits by its resolution.
    A duty without a speed loop holds no speed: then only a wheel that stands at a high duty, or is
    faster than its set-point by its whole working speed, is in doubt."""
    checks, joint = robot.safety.feedback, robot.joint[name]
    working_rad_s = working_speed_rad_s(robot, name, profile)
    count_rad = abs(rad_per_count(joint, profile)) if counter_bits(joint, profile) else 0.0
    unsure_rad_s = _UNSURE_COUNTS_PER_S * count_rad
    setpoint_min_rad_s = checks.setpoint_min_part * working_rad_s
    runaway_part, following_s = checks.runaway_part, checks.following_s
    loop = joint.speed_loop or SpeedLoop()
    if takes_duty(joint, profile) and not any(getattr(loop, key) for key in DUTY_GAINS):
        given = checks.model_fields_set
        full_duty_rad_s = joint.full_duty_rad_s or working_rad_s
        if "setpoint_min_part" not in given:
            setpoint_min_rad_s = max(setpoint_min_rad_s, _DUTY_THAT_TURNS * full_duty_rad_s)
        following_s = following_s if "following_s" in given else 0.0
        runaway_part = runaway_part if "runaway_part" in given else 1.0
    return {
        "setpoint_min_rad_s": max(
            setpoint_min_rad_s, _STALL_COUNTS * count_rad / (checks.stall_s or 1.0)
        ),
        "slow_rad_s": _SLOW_PART * working_rad_s,
        "short_rad_s": checks.following_part * working_rad_s + unsure_rad_s,
        "beyond_rad_s": runaway_part * working_rad_s + unsure_rad_s,
        "apart_rad_s": _APART_PART * working_rad_s + unsure_rad_s,
        "progress_rad_s": _PROGRESS_PART * working_rad_s,
        "direction_s": checks.direction_s,
        "stall_s": checks.stall_s,
        "following_s": following_s,
        "runaway_s": checks.runaway_s,
        "apart_s": checks.implausible_s,
        "jumps_max": checks.jumps_max,
    }


def _derating(derating: Derating) -> DeratingConfig:
    """Return the ranges of derating. 0 to 0: the limit is not given, and not in use."""
    found: list[DeratingRange] = []
    for begin, end in PAIRS.values():
        full, none = getattr(derating, begin), getattr(derating, end)
        given = full is not None and none is not None
        found.append({"full": full if given else 0.0, "none": none if given else 0.0})
    return {"range": found}


def speed_loop_gains(joint: Joint, profile: DriveProfile, loop: SpeedLoop) -> SpeedLoopGains:
    """Return the gains in the core's terms; empty for a drive that holds the speed by itself.
    Static and viscous feed-forward of a duty are its open-loop map."""
    found = SpeedLoopGains()
    for key, core_key in gains_of(joint, profile).items():
        found[core_key] = getattr(loop, key)
    if found and takes_duty(joint, profile) and joint.full_duty_rad_s is not None:
        found["static_u"] = joint.duty_dead_band
        found["viscous_u_s_per_rad"] = (1.0 - joint.duty_dead_band) / joint.full_duty_rad_s
    return found


def _speed_loop(joint: Joint, profile: DriveProfile, *, reversible: bool) -> SpeedLoopConfig:
    """Return the speed loop of a joint. A duty without gains is the open-loop map, and may get
    gains while the robot runs."""
    loop = joint.speed_loop or SpeedLoop()
    if takes_torque(joint, profile):
        most_n_m = loop.torque_max_n_m or 0.0
        low, high, correction, kind = -most_n_m, most_n_m, most_n_m, rt.SpeedLoopKind.TORQUE
    elif gains_of(joint, profile):
        low, high = joint.duty_min if reversible else 0.0, joint.duty_max
        correction, kind = loop.correction_max, rt.SpeedLoopKind.DUTY
    else:
        low = high = correction = 0.0
        kind = rt.SpeedLoopKind.NONE
    return {
        "gains": speed_loop_gains(joint, profile, loop),
        "filter_s": loop.filter_s,
        "correction_max_u": correction,
        "output_min_u": low,
        "output_max_u": high,
        "kind": kind,
    }


def _pwm(
    joint: Joint, profile: DriveProfile, forward_rad_s: float, *, reversible: bool
) -> rt.PwmConfig:
    """Return the map from speed to duty. For a drive that takes velocities the duty is only shown,
    1 at full speed."""
    full_duty_rad_s = joint.full_duty_rad_s if takes_duty(joint, profile) else None
    return {
        "dead_band": joint.duty_dead_band,
        "duty_min": joint.duty_min if reversible else 0.0,
        "duty_max": joint.duty_max,
        "slew_per_s": joint.duty_slew_per_s,
        "full_duty_rad_s": full_duty_rad_s or forward_rad_s,
    }
