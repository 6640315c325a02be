# SPDX-License-Identifier: Apache-2.0
"""Rules between wheels of one base that are usually alike. A gear ratio that stands on one side
only makes the robot drive in a curve, and its odometry with it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.sections.bases import CarBase, JointsBase
from motord.config.sections.joint.wheels import Profiles, counts_per_turn
from motord.config.sections.model import Joint, Robot

_RATIO_MAX = {
    "gear_ratio": 1.0,
    "counts_per_turn": 1.0,
    "wheel_radius_m": 1.1,
    "full_duty_rad_s": 1.5,
}
"""By how much the greater value may exceed the other: a calibration makes radii and the speed of
two motors at the same duty differ a little."""
_ROUNDING = 1e-9


def alike(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Compare each joint with the first of its group that has the same drive: what differs is a
    mistake, unless the file says with `differs_in` that it is meant."""
    for names in _groups(robot):
        for one, other in itertools.combinations(names, 2):
            if one != names[0] and robot.joint[one].drive == robot.joint[names[0]].drive:
                continue  # both are compared with the first
            yield from _compared(robot, profiles, one, other)


def _groups(robot: Robot) -> Iterator[list[str]]:
    """Yield the names of the joints whose wheels are usually alike: those of a base, or of an axle
    of a car; joints that steer by themselves."""
    if isinstance(robot.base, JointsBase):
        return
    groups: dict[tuple[bool, str], list[str]] = {}
    for name, joint in robot.joint.items():
        axle = (joint.place or "").partition("-")[0] if isinstance(robot.base, CarBase) else ""
        groups.setdefault((joint.steers, axle), []).append(name)
    yield from groups.values()


def _compared(robot: Robot, profiles: Profiles, one: str, other: str) -> Iterator[Finding]:
    first, second = robot.joint[one], robot.joint[other]
    if first.drive != second.drive:
        return
    for key, ratio_max in _RATIO_MAX.items():
        if key in first.differs_in or key in second.differs_in:
            continue
        if key == "counts_per_turn" and profiles[first.drive].speed_in_counts:
            continue  # rules/drive.py: such a drive has one number for all of its joints
        least, most = sorted(_value(robot, profiles, name, key) for name in (one, other))
        if least == 0.0 or most <= least * ratio_max * (1 + _ROUNDING):
            continue  # 0: no encoder, or no speed at full duty, which other rules report
        here, there = (other, one) if _written(second, key) else (one, other)
        text = (
            f"{_value(robot, profiles, here, key):g} differs from "
            f"{_value(robot, profiles, there, key):g} of joint {there} with the same drive: the "
            f'base drives a curve; if this is meant, add differs_in = ["{key}"]'
        )
        yield Finding((("joint", here, key), ("joint", here)), text)


def _value(robot: Robot, profiles: Profiles, name: str, key: str) -> float:
    joint = robot.joint[name]
    match key:
        case "counts_per_turn":
            return counts_per_turn(joint, profiles[joint.drive])
        case "wheel_radius_m":
            return robot.wheel_radius_m(name)
        case "full_duty_rad_s":
            return joint.full_duty_rad_s or 0.0
        case _:
            return joint.gear_ratio


def _written(joint: Joint, key: str) -> bool:
    return key in joint.model_fields_set
