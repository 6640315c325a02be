# SPDX-License-Identifier: Apache-2.0
"""Rules for joints that take positions: can the drive reach what their range asks of it?"""

from __future__ import annotations

import math
from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.rules.limits import ROUNDING
from motord.config.sections.joint.wheels import Profiles, counter_bits, takes_position
from motord.config.sections.model import Robot
from motord.config.wiring import line_specs
from motord_hal.drives.profile import DriveProfile, RegisterType
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.fieldbus.positions import HALF_A_STEP, raw_offset, raw_per_rad, raw_range


def positions(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Compare zero and range of each joint that takes positions with its counter and its drive."""
    for spec in line_specs(robot, profiles):
        for joint in spec.joints:
            own, profile = robot.joint[joint.name], joint.profile
            if not takes_position(own, profile) or profile.protocol == "pwm":
                continue
            yield from _zero(joint, counter_bits(own, profile))
            yield from _range(joint, profile)


def _zero(joint: JointSpec, bits: int) -> Iterator[Finding]:
    low, high = -(1 << bits) // 2, (1 << bits) - 1
    if bits and not low <= joint.zero_count <= high:
        text = (
            f"{joint.zero_count} is no position of its drive, which counts {bits} bits (to {high})"
        )
        yield Finding((("joint", joint.name, "zero_count"), ("joint", joint.name, "drive")), text)


def _range(joint: JointSpec, profile: DriveProfile) -> Iterator[Finding]:
    low, high = _drive_range(joint, profile)
    least, greatest = raw_range(joint, profile)
    if least >= low - HALF_A_STEP - ROUNDING and greatest <= high + HALF_A_STEP + ROUNDING:
        return
    zero, per_rad = raw_offset(joint, profile), raw_per_rad(joint, profile)
    reach = sorted(((low - zero) / per_rad, (high - zero) / per_rad))
    setpoint = profile.channels[joint.channel].setpoint
    text = (
        f"{joint.position_min_rad:g} to {joint.position_max_rad:g} rad are {least:.0f} to "
        f"{greatest:.0f} in {setpoint}, which goes from {low:g} to {high:g}: with this zero_count "
        f"the joint reaches {reach[0]:.3g} to {reach[1]:.3g} rad"
    )
    keys = ("position_max_rad", "position_min_rad", "zero_count", "gear_ratio")
    yield Finding(tuple(("joint", joint.name, key) for key in keys), text)


def _drive_range(joint: JointSpec, profile: DriveProfile) -> tuple[float, float]:
    """Return the least and the greatest raw set-point that the drive takes."""
    register = profile.registers[profile.channels[joint.channel].setpoint]
    floats = register.type is RegisterType.F32
    low, high = (-math.inf, math.inf) if floats else register.raw_range
    if register.minimum is not None:
        low = max(low, register.minimum / register.scale)
    if register.maximum is not None:
        high = min(high, register.maximum / register.scale)
    return low, high
