# SPDX-License-Identifier: Apache-2.0
"""What a joint and its drive can do together, at the wheel, after the gear."""

from __future__ import annotations

import math
from collections.abc import Mapping

from motord.config.sections.bases import JointsBase, wheel_row
from motord.config.sections.joint.speed_loop import DUTY_GAINS, TORQUE_GAINS, CoreGain
from motord.config.sections.line import AsciiLine
from motord.config.sections.model import Joint, Robot
from motord_hal.drives.profile import DriveProfile, Register, RegisterType

Profiles = Mapping[str, DriveProfile]
"""Profiles by the drive's name as the robot file writes it."""


def encoders_of(robot: Robot, drive: str, profile: DriveProfile) -> set[int]:
    """Return the counts per motor turn of the joints with this drive, except those with an
    [encoder] of their own."""
    joints = [joint for joint in robot.joint.values() if joint.drive == drive]
    return {counts_per_turn(joint, profile) for joint in joints if joint.encoder is None}


def takes_duty(joint: Joint, profile: DriveProfile) -> bool:
    """Return whether the set-point is a duty and not a velocity."""
    return profile.channels[joint.channel].duty_setpoint is not None


def takes_torque(joint: Joint, profile: DriveProfile) -> bool:
    """Return whether the set-point is a torque: then the core holds the speed."""
    return profile.channels[joint.channel].torque_setpoint is not None


def measures_speed(joint: Joint, profile: DriveProfile) -> bool:
    """Return whether the core measures how fast the wheel turns."""
    return bool(
        counter_bits(joint, profile) or profile.channels[joint.channel].velocity is not None
    )


def reports_speed(robot: Robot, name: str, profile: DriveProfile) -> bool:
    """Return whether the speed of a joint may be reported. A board that sends text reports what its
    template names, whatever its drives can."""
    joint = robot.joint[name]
    line = robot.line[joint.line]
    if profile.channels[joint.channel].velocity is None:
        return False
    if not isinstance(line, AsciiLine):
        return True
    return any(f"{{{name}_{unit}" in (line.feedback or "") for unit in ("rad_s", "m_s"))


def reports_motion(robot: Robot, name: str, profile: DriveProfile) -> bool:
    """Return whether something reports that the joint turns: a counter, or its speed."""
    return counter_bits(robot.joint[name], profile) > 0 or reports_speed(robot, name, profile)


def gains_of(joint: Joint, profile: DriveProfile) -> Mapping[str, CoreGain]:
    """Return the keys of [joint.NAME.speed_loop] that can be changed while the robot runs, with the
    core's names. Empty: motord does not hold the speed of this wheel."""
    if takes_torque(joint, profile):
        return TORQUE_GAINS
    return DUTY_GAINS if takes_duty(joint, profile) and measures_speed(joint, profile) else {}


def takes_position(joint: Joint, profile: DriveProfile) -> bool:
    """Return whether the set-point is an angle, to which the core moves the joint."""
    return profile.channels[joint.channel].position_setpoint is not None


def reference_of(joint: Joint, profile: DriveProfile) -> int:
    """Return how the angle of a joint that takes positions is known: position_reference of
    csrc/api/api_position.h. -1: it is not known."""
    if counter_bits(joint, profile) == 0:
        return 2
    return 0 if profile.absolute else 1 if profile.homed is not None else -1


def torque_max_n_m(joint: Joint, profile: DriveProfile) -> float:
    """Return the torque that the set-point can request, at the wheel; losses of the gear do not
    count."""
    return min(map(abs, _setpoint(joint, profile).si_limits)) * joint.gear_ratio


def drive_can_reverse(joint: Joint, profile: DriveProfile) -> bool:
    """Return whether the set-point can request to turn backward."""
    channel = profile.channels[joint.channel]
    if takes_position(joint, profile):
        return True
    setpoint = _setpoint(joint, profile)
    negative = setpoint.minimum < 0 if setpoint.minimum is not None else setpoint.type.signed
    return negative or channel.direction is not None


def drive_velocity_max_rad_s(joint: Joint, profile: DriveProfile) -> float:
    """Return the highest speed that the set-point can request. It is infinite for a torque, for a
    duty without `full_duty_rad_s`, and for an angle where the profile does not bound the speed of a
    move: only `velocity_max_rad_s` limits these."""
    setpoint = _setpoint(joint, profile)
    if takes_position(joint, profile):
        return profile.moves_at_rad_s(profile.channels[joint.channel]) / joint.gear_ratio
    if takes_torque(joint, profile):
        return math.inf
    if takes_duty(joint, profile):
        return math.inf if joint.full_duty_rad_s is None else joint.full_duty_rad_s * joint.duty_max
    return setpoint.si_limits[1] / joint.gear_ratio


def velocity_range_rad_s(joint: Joint, profile: DriveProfile) -> tuple[float, float]:
    """Return the wheel's speeds, backward (<= 0) and forward, that motord may request."""
    forward = drive_velocity_max_rad_s(joint, profile)
    if joint.velocity_max_rad_s is not None:
        forward = min(forward, joint.velocity_max_rad_s)
    reversible = joint.reversible is not False and drive_can_reverse(joint, profile)
    if not reversible:
        return 0.0, forward
    if takes_duty(joint, profile) and joint.full_duty_rad_s is not None:
        return max(-forward, joint.full_duty_rad_s * joint.duty_min), forward
    return -forward, forward


def all_reverse(robot: Robot) -> bool:
    """Return whether each wheel can turn backward."""
    return all(
        velocity_range_rad_s(joint, robot.profiles[joint.drive])[0] < 0.0
        for joint in robot.joint.values()
    )


def counts_per_turn(joint: Joint, profile: DriveProfile) -> int:
    """Return the counts per turn of the motor's shaft; 0: no counter."""
    if joint.encoder is not None:
        return joint.encoder.counts_per_turn
    own = joint.counts_per_turn
    return profile.counts_per_turn if own is None else own


def counter_bits(joint: Joint, profile: DriveProfile) -> int:
    """Return the width of the counter in bits; 0: no counter. The count of an [encoder] never
    wraps."""
    if joint.encoder is not None:
        return 64
    return profile.counter_bits if counts_per_turn(joint, profile) else 0


def counter_mantissa_bits(joint: Joint, profile: DriveProfile) -> int:
    """Return the bits of the floating-point number that the drive's counter is made of: its steps
    grow with it. 0: it has steps of one count."""
    position = profile.channels[joint.channel].position
    if joint.encoder is not None or position is None:
        return 0
    return 24 if profile.registers[position].type is RegisterType.F32 else 0


def rad_per_count(joint: Joint, profile: DriveProfile) -> float:
    """Return the wheel angle of one count: 2π / (counts per motor turn × motor turns per wheel
    turn), signed. Without a counter it is 1 or -1, and the core does not use it."""
    counts = counts_per_turn(joint, profile)
    backward = joint.inverted != (joint.encoder is not None and joint.encoder.reversed)
    sign = -1.0 if backward else 1.0
    return sign * 2 * math.pi / (counts * joint.gear_ratio) if counts else sign


def working_speed_rad_s(robot: Robot, name: str, profile: DriveProfile) -> float:
    """Return the highest speed that the limits request of a wheel, at most its own."""
    if isinstance(robot.base, JointsBase):
        return velocity_range_rad_s(robot.joint[name], profile)[1]
    limits = robot.limits
    row = wheel_row(robot.base, robot.joint[name])
    asked_m_s = abs(row.x) * limits.linear_m_s + abs(row.lever_m) * limits.angular_rad_s
    if robot.base.strafes:
        asked_m_s += abs(row.y) * limits.lateral_m_s
    asked_rad_s = asked_m_s / robot.wheel_radius_m(name)
    return min(asked_rad_s, velocity_range_rad_s(robot.joint[name], profile)[1])


def _setpoint(joint: Joint, profile: DriveProfile) -> Register:
    channel = profile.channels[joint.channel]
    return profile.registers[channel.setpoint]
