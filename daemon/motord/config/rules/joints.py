# SPDX-License-Identifier: Apache-2.0
"""Rules for joints without a base, and between them and their drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.rules.limits import joint_stops
from motord.config.rules.steering import engine_for_positions
from motord.config.sections.bases import JointsBase
from motord.config.sections.joint.limits import JointLimits
from motord.config.sections.joint.wheels import Profiles, reference_of, takes_position
from motord.config.sections.model import Joint, Robot
from motord.config.toml_lines import Path
from motord_hal.fieldbus.parameter import readable

_RANGE = ("position_min_rad", "position_max_rad")
_OF_POSITION = (*_RANGE, "zero_count")
_OF_WHEELS = ("ascii", "hoverboard")
"""Kinds of lines on which speeds are those of a base or its rims."""
_OF_VELOCITY = ("deceleration_max_rad_s2", "jerk_max_rad_s3")


def _keys(robot: Robot) -> Iterator[Finding]:
    """Check for keys that only a base has, or only joints without one."""
    if not isinstance(robot.base, JointsBase):
        for name, joint in robot.joint.items():
            for key in _OF_VELOCITY:
                if key in joint.model_fields_set:
                    text = 'only a joint without a base has it (kind = "joints"): see [limits]'
                    yield Finding((("joint", name, key),), text)
        return
    for section in ("limits", "odometry"):
        given = getattr(robot, section).model_fields_set
        if given:
            text = "there is no base: each joint has limits of its own, and there is no odometry"
            yield Finding(tuple((section, key) for key in sorted(given)), text)
    if robot.imu is not None:
        yield Finding((("imu",),), "there is no base whose heading a gyro could measure")
    for name, joint in robot.joint.items():
        line = robot.line.get(joint.line)
        if line is not None and line.kind in _OF_WHEELS:
            text = f"a line of kind {line.kind} carries the wheels of a base"
            yield Finding((("line", joint.line, "kind"), ("joint", name, "line")), text)
        if joint.wheel_radius_m is not None:
            text = "a joint without a base has no wheel"
            yield Finding((("joint", name, "wheel_radius_m"),), text)
        if joint.velocity_max_rad_s is None:
            text = "velocity_max_rad_s is missing: how fast may this joint move?"
            yield Finding((("joint", name, "velocity_max_rad_s"), ("joint", name)), text)


def _stops_in_time(robot: Robot) -> Iterator[Finding]:
    if not isinstance(robot.base, JointsBase):
        return
    for name, joint in robot.joint.items():
        yield from joint_stops(name, JointLimits.of(joint))


def _drives(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    if not isinstance(robot.base, JointsBase):
        return
    for name, joint in robot.joint.items():
        profile, drive = profiles[joint.drive], f'drive "{joint.drive}"'
        positions = takes_position(joint, profile)
        for key in _OF_VELOCITY if positions else _OF_POSITION:
            if key in joint.model_fields_set:
                other = "positions" if positions else "velocities"
                where: tuple[Path, ...] = (("joint", name, key), ("joint", name, "drive"))
                yield Finding(where, f"{drive} takes {other}: its joint does not have it")
        if not positions:
            continue
        yield from _range(name, joint)
        yield from engine_for_positions(robot, name, f"joint {name} takes positions")
        if reference_of(joint, profile) < 0:
            text = (
                f"{drive} counts from where it was switched on, and cannot report that it was "
                "homed: where the joint is would not be known"
            )
            yield Finding((("joint", name, "drive"),), text)


def _identity(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        for register in joint.identity:
            try:
                readable(profiles[joint.drive], register)
            except LookupError as error:
                yield Finding((("joint", name, "identity", register),), str(error))


def _range(name: str, joint: Joint) -> Iterator[Finding]:
    for key in _RANGE:
        if getattr(joint, key) is None:
            text = f"{key} is missing: how far may this joint go? (0 lies within its range)"
            yield Finding((("joint", name, key), ("joint", name)), text)
    if joint.position_min_rad == joint.position_max_rad == 0.0:
        where = tuple(("joint", name, key) for key in _RANGE)
        yield Finding(where, "a range of nothing: this joint could not move")


JOINT_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (_keys, _stops_in_time)
JOINT_DRIVE_RULES: tuple[Callable[[Robot, Profiles], Iterator[Finding]], ...] = (
    _drives,
    _identity,
)
