# SPDX-License-Identifier: Apache-2.0
"""What the limits of a base mean for this robot. `motord check` judges those of the robot file by
it, `params.set` those that are asked for while the robot runs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from motord.config.finding import Finding
from motord.config.sections.bases import wheel_row
from motord.config.sections.joint.limits import NUMBERS, JointLimits
from motord.config.sections.joint.wheels import Profiles, velocity_range_rad_s
from motord.config.sections.limits import REST_MAX_S, Limits, braking_s
from motord.config.sections.model import Robot
from motord.config.sections.section import numbers_of

ROUNDING = 1e-6
"""A limit that was computed by hand from rpm may be off in the last digit."""
STOP_USUAL_M = 3.0
"""Braking distance of a fast delivery robot; small robots have less."""
_NUMBERS = numbers_of(Limits)
_AXES = {"linear": "m", "angular": "rad", "lateral": "m"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Ceiling:
    """The highest speed of each axis alone that the wheels can do. inf: no wheel limits it."""

    linear_m_s: float
    angular_rad_s: float
    lateral_m_s: float

    def of(self, key: str) -> float:
        """Return the ceiling of a limit by its key; inf for one that is no speed."""
        return float(getattr(self, key, math.inf))


def ceiling(robot: Robot, profiles: Profiles) -> Ceiling:
    """Return what the wheels of these joints can do, forward, on the spot and sideways."""
    joints = robot.joint.items()
    ranges = {name: velocity_range_rad_s(joint, profiles[joint.drive]) for name, joint in joints}
    rows = {name: wheel_row(robot.base, joint) for name, joint in joints}

    def reach(parts: dict[str, float]) -> float:
        """Return how fast the base can move along an axis. `parts`: each rim's speed, as a part of
        the base's."""
        return min(
            (
                _most(ranges[name], part) * robot.wheel_radius_m(name) / abs(part)
                for name, part in parts.items()
                if part
            ),
            default=math.inf,
        )

    def either_direction(parts: dict[str, float]) -> float:
        return min(reach(parts), reach({name: -part for name, part in parts.items()}))

    return Ceiling(
        linear_m_s=reach({name: row.x for name, row in rows.items()}),
        angular_rad_s=either_direction({name: row.lever_m for name, row in rows.items()}),
        lateral_m_s=either_direction({name: row.y for name, row in rows.items()}),
    )


def _most(range_rad_s: tuple[float, float], part: float) -> float:
    """Return a wheel's highest speed in the direction in which it turns: forward for a positive
    part."""
    return range_rad_s[1] if part > 0.0 else -range_rad_s[0]


def stops(
    limits: Limits,
    *,
    strafes: bool,
    moving: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Iterator[Finding]:
    """Judge how long a stop takes and how far it goes. `moving`: speeds in m/s, rad/s and m/s to
    the left at which the robot already moves."""
    if (rest_s := limits.rest_s(*moving, strafes=strafes)) > REST_MAX_S:
        text = f"from full speed it takes {rest_s:.0f} s to rest (at most {REST_MAX_S:g} s)"
        yield Finding((("limits",),), f"{text}: more deceleration and jerk, or less speed")
    stop_m = stop_length(limits, "linear")
    if stop_m > STOP_USUAL_M:
        text = (
            f"from {limits.linear_m_s:g} m/s the robot takes {stop_m:.1f} m to rest: is there so "
            "much room? raise linear_deceleration_m_s2 or lower linear_m_s"
        )
        keys = ("linear_m_s", "linear_deceleration_m_s2")
        yield Finding(tuple(("limits", key) for key in keys), text, warning=True)


def reach(limits: Limits, most: Ceiling, joints: tuple[str, ...]) -> Iterator[Finding]:
    """Warn of limits that the wheels of these joints cannot serve. They are no error in a robot
    file: the core scales the twist down."""
    wheels = tuple(("joint", name, "velocity_max_rad_s") for name in joints)
    if limits.linear_m_s > most.linear_m_s * (1 + ROUNDING):
        text = (
            f"{limits.linear_m_s:g} m/s is never reached: the wheels do {most.linear_m_s:.4g} m/s"
        )
        yield Finding((("limits", "linear_m_s"), *wheels), text, warning=True)
    path = ("limits", "angular_rad_s")
    if most.angular_rad_s == 0.0:
        text = "wheels that cannot turn backward cannot turn this base on the spot"
        yield Finding((path, *wheels), text, warning=True)
    elif limits.angular_rad_s > most.angular_rad_s * (1 + ROUNDING):
        never = f"{limits.angular_rad_s:g} rad/s is never reached on the spot"
        text = f"{never}: the wheels do {most.angular_rad_s:.4g} rad/s"
        yield Finding((path, *wheels), text, warning=True)


def stop_length(limits: Limits, axis: str) -> float:
    """Return how far a stop from full speed goes on one axis, in m or rad: half of the speed on
    average, because the ramp is symmetric."""
    speed, deceleration, jerk = (getattr(limits, key) for key in _ramp(axis))
    return float(speed * braking_s(speed, deceleration, jerk) / 2.0)


def _ramp(axis: str) -> tuple[str, str, str]:
    unit = _AXES[axis]
    return f"{axis}_{unit}_s", f"{axis}_deceleration_{unit}_s2", f"{axis}_{unit}_s3"


def settable_max(file: Limits, key: str, most: Ceiling) -> float:
    """Return the highest value that a limit may get while the robot runs: what the wheels can do,
    and what the robot file has in any case. Wheels that cannot turn backward have no ceiling for
    turning: in a curve they turn all the same."""
    high = _NUMBERS[key].high
    ceiling_of_key = most.of(key) or math.inf
    wanted_max = max(ceiling_of_key, float(getattr(file, key)))
    return min(math.inf if high is None else high, wanted_max)


def beyond_file(
    made: Limits, now: Limits, file: Limits, keys: frozenset[str], *, strafes: bool
) -> Iterator[str]:
    """Yield what the new limits allow beyond the robot file and beyond those in force now: values
    above the file's, and stops that go further. `keys`: the limits that change. The robot was
    not tried with such limits."""
    for key in sorted(keys):
        own, value = getattr(file, key), getattr(made, key)
        if value > max(own, getattr(now, key)):
            unit = _NUMBERS[key].unit
            yield f"{key}: {value:g} {unit} is above the robot file's {own:g} {unit}"
    for axis, unit in _AXES.items():
        if axis == "lateral" and not strafes:
            continue
        new, before, known = (stop_length(one, axis) for one in (made, now, file))
        if new > max(before, known) * (1 + ROUNDING):
            speed = _ramp(axis)[0]
            yield (
                f"a stop from {getattr(made, speed):g} {_NUMBERS[speed].unit} goes {new:.2g} "
                f"{unit}, by the robot file {known:.2g} {unit}"
            )


def joint_stops(name: str, limits: JointLimits, velocity_rad_s: float = 0.0) -> Iterator[Finding]:
    """Judge how long a joint without a base takes to rest, from full speed or from this speed if it
    is higher."""
    if (rest_s := limits.rest_s(velocity_rad_s)) > REST_MAX_S:
        text = f"from full speed it takes {rest_s:.0f} s to rest (at most {REST_MAX_S:g} s)"
        keys = ("deceleration_max_rad_s2", "acceleration_max_rad_s2", "velocity_max_rad_s")
        yield Finding(
            tuple(("joint", name, key) for key in keys),
            f"{text}: more deceleration and jerk, or less speed",
        )


def joint_beyond_file(
    name: str, made: JointLimits, now: JointLimits, file: JointLimits
) -> Iterator[str]:
    """Yield what the new limits of a joint allow beyond the robot file, as `beyond_file` does."""
    for key, number in NUMBERS.items():
        own, value = getattr(file, key), getattr(made, key)
        if value > max(own, getattr(now, key)):
            where = f"joint.{name}.{key}"
            yield f"{where}: {value:g} {number.unit} is above the robot file's {own:g}"
    new_s, before_s, known_s = (one.rest_s() for one in (made, now, file))
    if new_s > max(before_s, known_s) * (1 + ROUNDING):
        yield f"a stop of joint {name} takes {new_s:.2g} s, by the robot file {known_s:.2g} s"
