# SPDX-License-Identifier: Apache-2.0
"""The position loop of a simulated drive. It goes to its target with a limited speed, and slows
down with a limited deceleration before it (the time-optimal approach: Lynch & Park, Modern
Robotics, 2017, 9.4)."""

from __future__ import annotations

import math

from motord_hal.drives.profile import DriveProfile
from motord_hal.sim.axis import Motor

SPEED_RAD_S = 8.0
DECELERATION_RAD_S2 = 40.0
GAIN_PER_S = 20.0
"""Speed over distance near the target. All three constants are at the wheel."""


def approach_rad_s(profile: DriveProfile, motor: Motor, goal_raw: int) -> float:
    """Return the wheel's speed towards the target, which is in the unit of the position."""
    counts_per_turn = motor.axis.counts_per_turn or profile.counts_per_turn
    target = profile.registers[motor.channel.setpoint]
    goal = target.to_si(goal_raw)
    if target.unit != "count":
        goal *= counts_per_turn / math.tau
    distance = goal - _count(profile, motor)
    if not math.isfinite(distance) or abs(distance) < 1.0:
        return 0.0
    distance_rad = distance / counts_per_turn * math.tau / motor.axis.motor_per_wheel
    braking_rad_s = math.sqrt(2.0 * DECELERATION_RAD_S2 * abs(distance_rad))
    speed_rad_s = min(SPEED_RAD_S, braking_rad_s, GAIN_PER_S * abs(distance_rad))
    return math.copysign(speed_rad_s, distance_rad)


def _count(profile: DriveProfile, motor: Motor) -> int:
    """Return the motor's counter, signed if it fills a signed register."""
    count, bits = motor.count or 0, profile.counter_bits
    position = profile.registers[motor.channel.position or ""]
    signed = position.type.signed and position.type.bits == bits
    return count - (1 << bits) if signed and count >> (bits - 1) else count
