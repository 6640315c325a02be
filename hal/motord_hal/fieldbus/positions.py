# SPDX-License-Identifier: Apache-2.0
"""Angles of a joint that takes positions, as raw numbers of its drive. Pure."""

from __future__ import annotations

import math

from motord_hal.drives.profile import DriveProfile, Register
from motord_hal.fieldbus.ports import JointSpec

HALF_A_STEP = 0.5
"""A range that was computed by hand ends within half a step of the drive's."""


def raw_offset(joint: JointSpec, profile: DriveProfile) -> float:
    """Return the raw set-point for the angle 0; 0 for set-points that are not positions."""
    channel = profile.channels[joint.channel]
    if channel.position_setpoint is None:
        return 0.0
    register, bits = profile.registers[channel.position_setpoint], profile.counter_bits
    count = joint.zero_count % (1 << bits)
    if register.type.signed and register.type.bits == bits and count >> (bits - 1):
        count -= 1 << bits  # the drive's number for that position has a sign
    return count * _unit_per_count(joint, profile, register) / register.scale


def raw_per_rad(joint: JointSpec, profile: DriveProfile) -> float:
    """Return the raw set-point for one radian of a joint that takes positions, as the core
    converts it."""
    register = profile.registers[profile.channels[joint.channel].setpoint]
    counts = (joint.counts_per_turn or profile.counts_per_turn) * joint.gear_ratio
    per_count = _unit_per_count(joint, profile, register) / register.scale
    return joint.sign * counts / (2.0 * math.pi) * per_count


def raw_per_s(joint: JointSpec, profile: DriveProfile) -> float:
    """Return the highest speed of the target of a joint that takes positions, in raw steps a
    second; 0 for other joints."""
    if profile.channels[joint.channel].position_setpoint is None:
        return 0.0
    return abs(raw_per_rad(joint, profile)) * joint.position_velocity_rad_s


def raw_range(joint: JointSpec, profile: DriveProfile) -> tuple[float, float]:
    """Return the least and the greatest raw set-point within the joint's range."""
    zero, per_rad = raw_offset(joint, profile), raw_per_rad(joint, profile)
    ends = (zero + per_rad * joint.position_min_rad, zero + per_rad * joint.position_max_rad)
    return min(ends), max(ends)


def _unit_per_count(joint: JointSpec, profile: DriveProfile, register: Register) -> float:
    """Return the register's unit for one count: 1 for a register in counts, else 1 / counts per
    turn, because the register is in turns."""
    counts = joint.counts_per_turn or profile.counts_per_turn
    return 1.0 if register.unit == "count" else 1.0 / counts
