# SPDX-License-Identifier: Apache-2.0
"""Oracle for ramps: the shortest time in which a twist changes, in continuous time.

Biagiotti & Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, 3.4: with a
limit of acceleration and one of jerk, the acceleration grows by the jerk, stays at its limit, and
falls by the jerk. Here the limit may change where a speed passes zero, and the change may begin
with an acceleration. On the straight line from a twist to its goal, with the share x of it that is
done, the time is the integral of 1 / x' over x. It is least where x' is as large as can be at every
x, and the jerk bounds the slope of its square: d(x'^2)/dx = 2 x''. So the square is the lower
envelope of straight lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise


@dataclass(frozen=True)
class Bounds:
    """Limits of one axis; u: the unit of the axis."""

    acceleration_u_s2: float
    """Limit while the speed moves away from zero."""
    deceleration_u_s2: float
    """Limit while the speed moves towards zero."""
    jerk_u_s3: float
    """Limit of the jerk; infinity: no limit."""


@dataclass(frozen=True)
class Change:
    """A change of the speed of one axis."""

    bounds: Bounds
    from_u_s: float
    goal_u_s: float
    along_u_s2: float = 0.0
    """Acceleration at the start, towards the goal; negative: away from it."""

    @property
    def size_u_s(self) -> float:
        return abs(self.goal_u_s - self.from_u_s)

    @property
    def turn(self) -> float:
        """Share of the change at which the speed passes zero; 0: it does not pass zero."""
        return abs(self.from_u_s) / self.size_u_s if self.from_u_s * self.goal_u_s < 0.0 else 0.0

    def most_s(self, share: float) -> float:
        """Return the largest x' at this share of the change."""
        grows = share > self.turn if self.turn else abs(self.goal_u_s) > abs(self.from_u_s)
        bounds = self.bounds
        most_u_s2 = bounds.acceleration_u_s2 if grows else bounds.deceleration_u_s2
        return most_u_s2 / self.size_u_s


@dataclass(frozen=True)
class _Line:
    """A straight line of x'^2 over x."""

    at_zero: float
    slope: float

    def at(self, share: float) -> float:
        return self.at_zero + self.slope * share


def shortest_s(*changes: Change) -> float:
    """Return the shortest time of all changes together, on a straight line and never back. These
    parts of the acceleration at the start may be dropped at once: parts beyond a limit, away from
    the goal or the line, and parts that the jerk could not take back before the goal."""
    moving = [one for one in changes if one.size_u_s > 0.0]
    if not moving:
        return 0.0
    ends = sorted({0.0, 1.0, *(one.turn for one in moving)})
    pieces = [
        (low, high, min(one.most_s(0.5 * (low + high)) for one in moving) ** 2)
        for low, high in pairwise(ends)
    ]
    jerk_s3 = min(one.bounds.jerk_u_s3 / one.size_u_s for one in moving)
    if math.isinf(jerk_s3):
        return sum((high - low) / math.sqrt(most2) for low, high, most2 in pieces)
    slope = 2.0 * jerk_s3
    start_s = min(max(one.along_u_s2, 0.0) / one.size_u_s for one in moving)
    outer = [_Line(start_s**2, slope), _Line(slope, -slope)]
    total_s = 0.0
    for low, high, most2 in pieces:
        before = [_Line(m - slope * h, slope) for _, h, m in pieces if h <= low]
        after = [_Line(m + slope * w, -slope) for w, _, m in pieces if w >= high]
        lines = [*outer, *before, *after, _Line(most2, 0.0)]
        total_s += _piece_s(jerk_s3, low, high, lines)
    return total_s


def _piece_s(jerk_s3: float, low: float, high: float, lines: Sequence[_Line]) -> float:
    """Return the time from `low` to `high` along the lower envelope of `lines`. Each line lasts
    from one crossing to the next."""
    crossings = {
        (b.at_zero - a.at_zero) / (a.slope - b.slope)
        for a, b in combinations(lines, 2)
        if a.slope != b.slope
    }
    total_s = 0.0
    for start, end in pairwise([low, *sorted(x for x in crossings if low < x < high), high]):
        line = min(lines, key=lambda one: one.at(0.5 * (start + end)))
        first, last = (math.sqrt(max(line.at(x), 0.0)) for x in (start, end))
        total_s += (end - start) / first if line.slope == 0.0 else abs(last - first) / jerk_s3
    return total_s


def textbook_s(change: Change) -> float:
    """Return the shortest time of one axis that drops no acceleration: one that points away from
    the goal, or leads beyond it, is first taken back by the jerk."""
    bounds, along = change.bounds, change.along_u_s2
    beyond = along > 0.0 and along**2 > 2.0 * bounds.jerk_u_s3 * change.size_u_s
    if math.isinf(bounds.jerk_u_s3) or (along >= 0.0 and not beyond):
        return shortest_s(change)
    back_s = abs(along) / bounds.jerk_u_s3
    sense = 1.0 if change.goal_u_s > change.from_u_s else -1.0
    turned_u_s = change.from_u_s + sense * 0.5 * along * back_s
    return back_s + shortest_s(Change(bounds, turned_u_s, change.goal_u_s))
