# SPDX-License-Identifier: Apache-2.0
"""Twists that point the steered wheels of a base so that a person can judge them. Pure.

Steered wheels cannot be pointed one by one, since a base moves by twists alone. Over a few poses
each wheel points left, straight ahead or right in a pattern of its own: a wheel that shows another
one's pattern is swapped with it, and a wheel that shows the opposite of its own is inverted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

Side = Literal["left", "straight", "right"]
SIDES: tuple[Side, ...] = ("left", "straight", "right")
LEFT_RAD = 0.35
"""Angle to the side, about 20 degrees, which a person sees at a glance."""
SEEN_RAD = 0.1
"""A wheel that is off by less points straight ahead, for a person."""
CLEAR_RAD = 1.2
"""A wheel that points farther to the side points neither left nor right, for a person."""
_SAME_M = 1e-3
_RANGE_PART = 0.8


@dataclass(frozen=True, slots=True)
class Module:
    """A wheel from the daemon's answer of `robot`; a joint that it does not have is empty."""

    x_m: float
    y_m: float
    steering: str
    traction: str
    range_rad: tuple[float, float]
    """Range of the joint that steers it."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A twist in which the fastest wheel rolls 1 m/s, and where it points the steered wheels."""

    linear: float
    lateral: float
    angular: float
    aim_rad: Mapping[str, float]
    """Angle of each steering joint, counterclockwise from straight ahead."""

    def side(self, joint: str) -> Side:
        """Return where the joint's wheel points, for a person."""
        aim_rad = self.aim_rad[joint]
        if abs(aim_rad) < SEEN_RAD:
            return "straight"
        return "left" if aim_rad > 0.0 else "right"


STRAIGHT_TWIST = (1.0, 0.0, 0.0)


def modules_of(robot: Mapping[str, Any]) -> list[Module]:
    """Return the wheels from the daemon's answer of `robot`; empty: no steered wheels."""
    return [
        Module(**(one | {"range_rad": tuple(one["range_rad"])})) for one in robot.get("modules", ())
    ]


def straight(modules: Sequence[Module]) -> Pose:
    """Return the pose with all wheels straight ahead."""
    return _pose(modules, STRAIGHT_TWIST)


def poses_of(modules: Sequence[Module], *, strafes: bool) -> list[Pose]:
    """Return the fewest poses that give each wheel a pattern of its own, as far as the base can: a
    car steers all its wheels to the same side."""
    steered = [one for one in modules if one.steering]
    if not strafes:
        return [_pose(modules, (1.0, 0.0, _curvature_per_m(steered)))]
    rows_m = _distinct([one.x_m for one in steered])
    if len(rows_m) == 1:
        return [_pose(modules, (1.0, math.tan(LEFT_RAD), 0.0))]
    # the wheels of one row stay straight, those before it point left, those behind it right
    widest_m = rows_m[-1] - rows_m[0]
    angular = math.tan(LEFT_RAD) / widest_m
    found = [_pose(modules, (1.0, -x_m * angular, angular)) for x_m in (rows_m[0], rows_m[-1])]
    on_spot = _pose(modules, (0.0, 0.0, 1.0))
    if all(abs(aim_rad) < CLEAR_RAD for aim_rad in on_spot.aim_rad.values()):
        found.append(on_spot)  # left and right wheels point to opposite sides
    return found


def patterns(poses: Sequence[Pose]) -> dict[str, tuple[Side, ...]]:
    """Return where the wheel of each steering joint points in each pose."""
    return {name: tuple(pose.side(name) for pose in poses) for name in poses[0].aim_rad}


def opposite(pattern: tuple[Side, ...]) -> tuple[Side, ...]:
    """Return the pattern of the same joint when it is inverted."""
    return tuple(SIDES[2 - SIDES.index(side)] for side in pattern)


def standing(modules: Sequence[Module], traction: str) -> Pose:
    """Return the pose of a turn about this wheel, in which it stands and the others roll."""
    own = next(one for one in modules if one.traction == traction)
    return _pose(modules, (own.y_m, -own.x_m, 1.0))


def _curvature_per_m(steered: Sequence[Module]) -> float:
    """Return a curvature to the left that every wheel of a car's steered axle can follow."""
    behind = steered[0].x_m < 0.0
    ends_rad = [-one.range_rad[0] if behind else one.range_rad[1] for one in steered]
    return math.tan(min(LEFT_RAD, _RANGE_PART * min(ends_rad))) / abs(steered[0].x_m)


def _distinct(values_m: Sequence[float]) -> list[float]:
    found: list[float] = []
    for value_m in sorted(values_m):
        if not found or value_m - found[-1] > _SAME_M:
            found.append(value_m)
    return found


def _pose(modules: Sequence[Module], twist: tuple[float, float, float]) -> Pose:
    linear, lateral, angular = twist
    floor = {one: (linear - one.y_m * angular, lateral + one.x_m * angular) for one in modules}
    fastest = max(math.hypot(*speed) for speed in floor.values())
    aim_rad = {
        one.steering: _aim_rad(*speed) if math.hypot(*speed) > 1e-6 * fastest else 0.0
        for one, speed in floor.items()
        if one.steering
    }
    return Pose(linear / fastest, lateral / fastest, angular / fastest, aim_rad)


def _aim_rad(x_m_s: float, y_m_s: float) -> float:
    """Return the angle to which a wheel is steered, rolling forward or backward, whichever is
    nearer to straight ahead."""
    angle_rad = math.atan2(y_m_s, x_m_s)
    return angle_rad - math.pi * round(angle_rad / math.pi)
