# SPDX-License-Identifier: Apache-2.0
"""One motion over a given distance or angle, by the odometry: how fast to go now, and when and why
it ends.

Pure: the state comes in as snapshots, the time as an argument; out come steps, one a snapshot. The
core limits and ramps it like any other; a motion that is not asked on lapses with its lease.
`u` in a name stands for the axis's own unit: m on the linear axis, rad on the angular one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Literal

from motord.api.snapshot import Snapshot

Axis = Literal["linear", "angular"]
LAG_S = 0.15
"""From a command to the odometry that shows it, at most: line cycle, drive and state page."""
COMMANDS_WITHIN_S = 1.0
"""A lease that is not in command by then does not get it."""
RESTS_WITHIN_S = 5.0
"""Longest time from the goal to rest, in addition to the ramp itself."""
LOOK_WITHIN_S = 0.9
STUCK_S = 3.0
"""A base that comes no nearer for this time, in addition to that of its acceleration, is stuck."""
TURN_RATE_MAX_RAD_S = math.pi
"""Keeps the base from half a turn between two looks, which would hide its direction."""
CORRECTIONS_MAX, CORRECTION_TOLERANCES = 3, 10.0
"""A base that has come to rest beside its goal is corrected, also backward: at most this often, and
by at most this many tolerances."""
STOPS_EVERY_S = 0.1
"""How often the daemon is asked for its count of stops, in addition to the state page."""
UNSTOPPED_WITHIN_S = 1.0
"""Nothing is corrected unless the daemon reports within this time at rest that no stop came."""
DISTANCE_MAX_U = 1000.0
TOLERANCE_U = {"linear": 0.01, "angular": 0.02}
"""Where a goal names none."""
TIMEOUT_MAX_S = 3600.0
CANNOT_STRAFE = "this base cannot move sideways: turn it, then move"
_NS = 1e-9


class End(Enum):
    """How it ended."""

    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """An axis's limits, as the robot file and `params.set` have them. All positive."""

    velocity_u_s: float
    acceleration_u_s2: float
    deceleration_u_s2: float
    jerk_u_s3: float
    """Infinity: no limit."""

    def approach_u_s(self, distance_u: float) -> float:
        """The speed from which it comes to rest within that distance: v lag + v d / (2 j) + v² / (2
        d), a uniform deceleration that begins late by the lag and rises by the jerk."""
        late_s = LAG_S + self.deceleration_u_s2 / (2.0 * self.jerk_u_s3)
        root_s = math.sqrt(late_s * late_s + 2.0 * max(distance_u, 0.0) / self.deceleration_u_s2)
        return self.deceleration_u_s2 * (root_s - late_s)

    def duration_s(self, distance_u: float, velocity_u_s: float) -> float:
        """Of a trapezoid over that distance, somewhat more."""
        ramps_s = velocity_u_s / self.acceleration_u_s2 + velocity_u_s / self.deceleration_u_s2
        jerks_s = (self.acceleration_u_s2 + self.deceleration_u_s2) / self.jerk_u_s3
        return abs(distance_u) / velocity_u_s + ramps_s + jerks_s


_KEYS = {
    "linear": ("m_s", "m_s2", "deceleration_m_s2", "m_s3"),
    "angular": ("rad_s", "rad_s2", "deceleration_rad_s2", "rad_s3"),
    "lateral": ("m_s", "m_s2", "deceleration_m_s2", "m_s3"),
}
_ALONG = 1e-9
"""A part of the direction that is less is rounding."""


def _names(axis: str) -> tuple[str, ...]:
    """The parameters of that axis, in the order of Bounds."""
    return tuple(f"limits.{axis}_{key}" for key in _KEYS[axis])


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """What is requested; 0 stands for the robot's own value."""

    axis: Axis
    distance_u: float
    """Its sign is the direction."""
    velocity_u_s: float = 0.0
    tolerance_u: float = 0.0
    timeout_s: float = 0.0
    direction_rad: float = 0.0
    """Of a linear one, from straight ahead, counterclockwise: pi / 2 is to the left."""

    @property
    def parts(self) -> dict[str, float]:
        """The share of each axis, as parts of one."""
        if self.axis == "angular":
            return {"angular": 1.0}
        if not math.isfinite(self.direction_rad):
            raise ValueError("the direction has to be a finite number")
        along = {"linear": math.cos(self.direction_rad), "lateral": math.sin(self.direction_rad)}
        return {axis: part for axis, part in along.items() if abs(part) > _ALONG}

    @property
    def strafes(self) -> bool:
        """It goes sideways too."""
        return "lateral" in self.parts


def limit_names(goal: Goal) -> tuple[str, ...]:
    """The parameters that bound it. Raises ValueError."""
    return tuple(name for axis in goal.parts for name in _names(axis))


def bounds_of(goal: Goal, sent: Mapping[str, float | None]) -> Bounds:
    """Along its direction, from `params.get`, where null is no limit."""
    of_axes = [
        [math.inf if (value := sent[name]) is None else value / abs(part) for name in _names(axis)]
        for axis, part in goal.parts.items()
    ]
    velocity, acceleration, deceleration, jerk = map(min, zip(*of_axes, strict=True))
    return Bounds(
        velocity_u_s=velocity,
        acceleration_u_s2=acceleration,
        deceleration_u_s2=deceleration,
        jerk_u_s3=jerk,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A goal that can be."""

    axis: Axis
    distance_u: float
    velocity_u_s: float
    tolerance_u: float
    timeout_s: float
    bounds: Bounds
    direction_rad: float = 0.0

    def along_m_s(self, snapshot: Snapshot) -> float:
        """How fast the base moves in the direction of the goal."""
        forward_m_s = snapshot.linear_m_s * math.cos(self.direction_rad)
        return forward_m_s + snapshot.lateral_m_s * math.sin(self.direction_rad)


def planned(goal: Goal, bounds: Bounds) -> Plan:
    """Raises ValueError, in words, for a goal that cannot be."""
    numbers = (goal.distance_u, goal.velocity_u_s, goal.tolerance_u, goal.timeout_s)
    if not all(map(math.isfinite, numbers)):
        raise ValueError("distance, speed, tolerance and time-out have to be finite numbers")
    if not 0.0 < abs(goal.distance_u) <= DISTANCE_MAX_U:
        raise ValueError(
            f"a distance of {goal.distance_u:g} is out of range (not 0, at most {DISTANCE_MAX_U:g})"
        )
    if min(goal.velocity_u_s, goal.tolerance_u, goal.timeout_s) < 0.0:
        raise ValueError(
            "speed, tolerance and time-out must not be negative; the distance has the sign"
        )
    if goal.timeout_s > TIMEOUT_MAX_S:
        raise ValueError(
            f"a time-out of {goal.timeout_s:g} s is too long (at most {TIMEOUT_MAX_S:g} s)"
        )
    velocity_u_s = min(goal.velocity_u_s or bounds.velocity_u_s, bounds.velocity_u_s)
    if goal.axis == "angular":
        velocity_u_s = min(velocity_u_s, TURN_RATE_MAX_RAD_S)
    tolerance_u = goal.tolerance_u or TOLERANCE_U[goal.axis]
    least_s = bounds.duration_s(goal.distance_u, velocity_u_s)
    return Plan(
        axis=goal.axis,
        distance_u=goal.distance_u,
        velocity_u_s=velocity_u_s,
        tolerance_u=tolerance_u,
        timeout_s=goal.timeout_s or 2.0 * least_s + RESTS_WITHIN_S,
        bounds=bounds,
        direction_rad=goal.direction_rad,
    )


def problem(snapshot: Snapshot, now_ns: int, stale_s: float) -> str | None:
    """Why the odometry cannot be used. None: it can."""
    if (now_ns - snapshot.stamp_ns) * _NS > stale_s:
        return "the loop has stopped publishing its state"
    if any(joint.stale for joint in snapshot.joints):
        return "the odometry is stale: a wheel sends no feedback"
    if (now_ns - snapshot.odometry_stamp_ns) * _NS > stale_s:
        return "the odometry is stale"
    pose = (snapshot.x_m, snapshot.y_m, snapshot.heading_rad, snapshot.odometry_stamp_ns)
    return None if all(map(math.isfinite, pose)) else "the odometry is not a number"


def obstacle(snapshot: Snapshot) -> str | None:
    """Why nothing may move now."""
    if snapshot.faults:
        return f"a fault is latched: {', '.join(snapshot.faults)}"
    if not snapshot.armed:
        return "it is not armed"
    if "stop_requested" in snapshot.reasons:
        return "a stop was requested"
    return None


class Travel:
    """What was travelled since a beginning, signed: distance in a direction of the base, angle."""

    def __init__(self, start: Snapshot, direction_rad: float = 0.0) -> None:
        self._last = start
        self._direction_rad = direction_rad
        self.distance_m = 0.0
        self.angle_rad = 0.0

    def add(self, snapshot: Snapshot) -> str | None:
        """Why the distance is not known any more. None: it is known."""
        if snapshot.odometry_epoch != self._last.odometry_epoch:
            return "the odometry was reset"
        if (snapshot.stamp_ns - self._last.stamp_ns) * _NS > LOOK_WITHIN_S:
            return f"the state was not read for {LOOK_WITHIN_S:g} s"
        turn_rad = math.remainder(snapshot.heading_rad - self._last.heading_rad, math.tau)
        middle_rad = self._last.heading_rad + turn_rad / 2.0 + self._direction_rad
        dx_m, dy_m = snapshot.x_m - self._last.x_m, snapshot.y_m - self._last.y_m
        self.distance_m += dx_m * math.cos(middle_rad) + dy_m * math.sin(middle_rad)
        self.angle_rad += turn_rad
        self._last = snapshot
        return None


@dataclass(frozen=True, slots=True)
class MotionStep:
    """What to command now; with `end`, that and no more."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0
    lateral_m_s: float = 0.0
    end: End | None = None
    why: str = ""


class Motion:
    """One goal in progress. `step` again and again, with the newest snapshot."""

    def __init__(
        self, plan: Plan, start: Snapshot, now_ns: int, *, lease: int, stale_s: float, stops: int
    ) -> None:
        """`lease`: the number under which its commands are sent. `stale_s`: older states are not
        used. `stops`: how many the daemon had counted before."""
        self.plan = plan
        self.travel = Travel(start, plan.direction_rad)
        self._lease, self._stale_s = lease, stale_s
        self._start_ns = now_ns
        self._stops, self._stopped, self._unstopped_ns = stops, False, now_ns
        self._rest_ns: int | None = None
        self._commanding = False
        self._ending: tuple[End, str] | None = None
        self._ending_ns = 0
        self._near_u, self._near_ns = abs(plan.distance_u), now_ns
        self._forward = 1.0
        self._corrections = 0

    @property
    def distance_u(self) -> float:
        """Done so far, with its sign."""
        return self.travel.distance_m if self.plan.axis == "linear" else self.travel.angle_rad

    @property
    def remaining_u(self) -> float:
        """To go; negative behind the goal."""
        return math.copysign(1.0, self.plan.distance_u) * (self.plan.distance_u - self.distance_u)

    def cancel(self, now_ns: int) -> None:
        """Come to rest, and end there."""
        self._end(End.CANCELED, "canceled", now_ns)

    def counted(self, stops: int, asked_ns: int) -> None:
        """How many stops the daemon had counted when it was asked at that time. On the state page a
        stop is only seen until the robot rests: one that was short is over before the next look."""
        if stops != self._stops:
            self._stopped = True
        else:
            self._unstopped_ns = asked_ns

    def step(self, snapshot: Snapshot, now_ns: int) -> MotionStep:
        """The step that follows from what is known now."""
        why = self._trouble(snapshot, now_ns)
        if why is not None:
            return MotionStep(end=End.ABORTED, why=why)
        if (now_ns - self._start_ns) * _NS > self.plan.timeout_s:
            self._end(End.ABORTED, f"it took longer than {self.plan.timeout_s:.1f} s", now_ns)
        if self.remaining_u * self._forward <= self.plan.tolerance_u / 2.0:
            self._end(End.SUCCEEDED, "", now_ns)
        if self._ending is None and self._stuck(now_ns):
            self._end(End.ABORTED, "it is stuck", now_ns)
        if self._ending is None:
            return self._onward()
        return self._come_to_rest(snapshot, now_ns)

    def _trouble(self, snapshot: Snapshot, now_ns: int) -> str | None:
        """What ends it at once."""
        why = problem(snapshot, now_ns, self._stale_s) or obstacle(snapshot)
        if self._stopped:
            why = why or "a stop was requested"
        why = why or self.travel.add(snapshot)
        if why is not None:
            return why
        if snapshot.owner == self._lease:
            self._commanding = True
        elif self._commanding:
            return "another source commands" if snapshot.owner else "its commands no longer arrive"
        elif (now_ns - self._start_ns) * _NS > COMMANDS_WITHIN_S:
            return "another source commands" if snapshot.owner else "its commands do not arrive"
        return None

    def _end(self, how: End, why: str, now_ns: int) -> None:
        """The first reason counts."""
        if self._ending is None:
            self._ending, self._ending_ns = (how, why), now_ns

    def _stuck(self, now_ns: int) -> bool:
        """A step is a quarter of what it creeps in that time, or of the tolerance."""
        plan, bounds = self.plan, self.plan.bounds
        step_u = min(plan.tolerance_u, self._creep_u_s() * STUCK_S) / 4.0
        if abs(self.remaining_u) <= self._near_u - step_u:
            self._near_u, self._near_ns = abs(self.remaining_u), now_ns
        starts_s = plan.velocity_u_s / bounds.acceleration_u_s2
        starts_s += bounds.acceleration_u_s2 / bounds.jerk_u_s3
        return (now_ns - self._near_ns) * _NS > STUCK_S + starts_s

    def _creep_u_s(self) -> float:
        """Stops within half of the tolerance."""
        creep_u_s = self.plan.bounds.approach_u_s(self.plan.tolerance_u / 2.0)
        return min(creep_u_s, self.plan.velocity_u_s)

    def _onward(self) -> MotionStep:
        """Not slower than what gets there."""
        plan = self.plan
        speed_u_s = max(plan.bounds.approach_u_s(abs(self.remaining_u)), self._creep_u_s())
        speed_u_s = math.copysign(min(speed_u_s, plan.velocity_u_s), plan.distance_u)
        return self._along(speed_u_s * self._forward)

    def _along(self, speed_u_s: float) -> MotionStep:
        if self.plan.axis == "angular":
            return MotionStep(angular_rad_s=speed_u_s)
        if self.plan.direction_rad == 0.0:
            return MotionStep(linear_m_s=speed_u_s)
        direction_rad = self.plan.direction_rad
        return MotionStep(
            linear_m_s=speed_u_s * math.cos(direction_rad),
            lateral_m_s=speed_u_s * math.sin(direction_rad),
        )

    def _come_to_rest(self, snapshot: Snapshot, now_ns: int) -> MotionStep:
        assert self._ending is not None
        how, why = self._ending
        if not snapshot.at_rest:
            self._rest_ns = None
            if (now_ns - self._ending_ns) * _NS > RESTS_WITHIN_S + self._ramp_s():
                return MotionStep(end=End.ABORTED, why="it does not come to rest")
            return MotionStep()
        self._rest_ns = now_ns if self._rest_ns is None else self._rest_ns
        if how is End.SUCCEEDED and abs(self.remaining_u) > self.plan.tolerance_u:
            unstopped = self._unstopped_ns > self._rest_ns
            if not unstopped and (now_ns - self._rest_ns) * _NS <= UNSTOPPED_WITHIN_S:
                return MotionStep()  # something else may have brought it to rest
            if unstopped and self._corrected(now_ns):
                return MotionStep()
            how, why = End.ABORTED, f"it rests {-self.remaining_u:.3g} behind the goal"
        return MotionStep(end=how, why=why)

    def _corrected(self, now_ns: int) -> bool:
        """It goes on, towards the goal from where it is."""
        near_u = CORRECTION_TOLERANCES * self.plan.tolerance_u
        if abs(self.remaining_u) > near_u or self._corrections == CORRECTIONS_MAX:
            return False
        self._corrections += 1
        self._near_u, self._near_ns = abs(self.remaining_u), now_ns
        self._forward = math.copysign(1.0, self.remaining_u)
        self._ending = self._rest_ns = None
        return True

    def _ramp_s(self) -> float:
        bounds = self.plan.bounds
        jerk_s = bounds.deceleration_u_s2 / bounds.jerk_u_s3
        return bounds.velocity_u_s / bounds.deceleration_u_s2 + jerk_s
