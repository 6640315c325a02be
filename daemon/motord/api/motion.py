# SPDX-License-Identifier: Apache-2.0
"""One motion over a given distance or angle, measured by the odometry: its speed at each step, and
when and why it ends.

Pure: the state comes in as snapshots and the time as an argument; for each snapshot a step comes
out. The core limits and ramps the commands like any others. A motion whose `step` is no longer
called ends when its lease expires. `u` in a name stands for the axis's own unit: m on the linear
axis, rad on the angular one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Literal

from motord.api.commands import out_of_range
from motord.api.snapshot import Snapshot, stamp_is_fresh

Axis = Literal["linear", "angular"]
LAG_S = 0.15
"""Longest time from a command to the odometry that shows it: line cycle, drive and state page."""
COMMANDS_WITHIN_S = 1.0
"""Time within which the motion's lease has to be in command; after it the motion is aborted."""
RESTS_WITHIN_S = 5.0
"""Longest time from the goal to rest, in addition to the ramp itself."""
LOOK_WITHIN_S = 0.9
STUCK_S = 3.0
"""A base that comes no nearer to its goal for this time, plus the time to accelerate, is stuck."""
TURN_RATE_MAX_RAD_S = math.pi
"""Greatest turn rate. A half turn between two looks would hide the direction of the turn."""
CORRECTIONS_MAX, CORRECTION_TOLERANCES = 3, 10.0
"""How often a base that rests beside its goal is corrected, forward or backward, and from how many
tolerances beside it at most."""
STOPS_EVERY_S = 0.1
"""Interval at which the daemon's count of stops is read, in addition to the state page."""
UNSTOPPED_WITHIN_S = 1.0
"""Time at rest within which the daemon has to report that no stop came; else nothing is
corrected."""
DISTANCE_MAX_U = 1000.0
TOLERANCE_U = {"linear": 0.01, "angular": 0.02}
"""Tolerances of a goal that names none."""
TIMEOUT_MAX_S = 3600.0
CANNOT_STRAFE = "this base cannot move sideways: turn it, then move"
_NS = 1e-9


class End(Enum):
    """How a motion ended."""

    SUCCEEDED = "succeeded"
    CANCELED = "canceled"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """The limits of an axis, from the robot file and `params.set`. All are positive."""

    velocity_u_s: float
    acceleration_u_s2: float
    deceleration_u_s2: float
    jerk_u_s3: float
    """Infinity: no limit."""

    def approach_u_s(self, distance_u: float) -> float:
        """Return the speed from which the base comes to rest within that distance. It solves
        distance = v lag + v d / (2 j) + v² / (2 d): a uniform deceleration d that begins late by
        the lag and rises by the jerk j."""
        late_s = LAG_S + self.deceleration_u_s2 / (2.0 * self.jerk_u_s3)
        root_s = math.sqrt(late_s * late_s + 2.0 * max(distance_u, 0.0) / self.deceleration_u_s2)
        return self.deceleration_u_s2 * (root_s - late_s)

    def duration_s(self, distance_u: float, velocity_u_s: float) -> float:
        """Return the duration of a trapezoidal speed profile over that distance, slightly
        overestimated."""
        ramps_s = velocity_u_s / self.acceleration_u_s2 + velocity_u_s / self.deceleration_u_s2
        jerks_s = (self.acceleration_u_s2 + self.deceleration_u_s2) / self.jerk_u_s3
        return abs(distance_u) / velocity_u_s + ramps_s + jerks_s


_KEYS = {
    "linear": ("m_s", "m_s2", "deceleration_m_s2", "m_s3"),
    "angular": ("rad_s", "rad_s2", "deceleration_rad_s2", "rad_s3"),
    "lateral": ("m_s", "m_s2", "deceleration_m_s2", "m_s3"),
}
_ALONG = 1e-9
"""A smaller component of the direction is a rounding error."""


def _names(axis: str) -> tuple[str, ...]:
    """Return the names of the axis's limit parameters, in the order of Bounds."""
    return tuple(f"limits.{axis}_{key}" for key in _KEYS[axis])


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """A requested motion; for speed, tolerance and time-out, 0 stands for the robot's own value."""

    axis: Axis
    distance_u: float
    """Negative: against the direction, or a turn to the right."""
    velocity_u_s: float = 0.0
    tolerance_u: float = 0.0
    timeout_s: float = 0.0
    direction_rad: float = 0.0
    """Direction of a linear motion, counterclockwise from straight ahead: pi / 2 is to the left."""

    @property
    def parts(self) -> dict[str, float]:
        """The component of the direction on each axis that moves, -1 to 1. Raises ValueError."""
        if self.axis == "angular":
            return {"angular": 1.0}
        if not math.isfinite(self.direction_rad):
            raise ValueError("the direction has to be a finite number")
        along = {"linear": math.cos(self.direction_rad), "lateral": math.sin(self.direction_rad)}
        return {axis: part for axis, part in along.items() if abs(part) > _ALONG}

    @property
    def strafes(self) -> bool:
        """Whether the motion goes sideways, too."""
        return "lateral" in self.parts


def limit_names(goal: Goal) -> tuple[str, ...]:
    """Return the names of the parameters that limit the motion. Raises ValueError."""
    return tuple(name for axis in goal.parts for name in _names(axis))


def bounds_of(goal: Goal, sent: Mapping[str, float | None]) -> Bounds:
    """Return the limits along the goal's direction. `sent`: the answer of `params.get`; None: no
    limit."""
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
    """A goal that was checked, with the robot's own values filled in."""

    axis: Axis
    distance_u: float
    velocity_u_s: float
    tolerance_u: float
    timeout_s: float
    bounds: Bounds
    direction_rad: float = 0.0

    def along_m_s(self, snapshot: Snapshot) -> float:
        """Return the speed of the base in the direction of the goal."""
        forward_m_s = snapshot.linear_m_s * math.cos(self.direction_rad)
        return forward_m_s + snapshot.lateral_m_s * math.sin(self.direction_rad)


def planned(goal: Goal, bounds: Bounds) -> Plan:
    """Check and complete a goal. Raises ValueError, with the reason, for an impossible goal."""
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
    unit, most_u_s = "m/s", bounds.velocity_u_s
    if goal.axis == "angular":
        unit, most_u_s = "rad/s", min(most_u_s, TURN_RATE_MAX_RAD_S)
    for why in (
        out_of_range("the speed", goal.velocity_u_s, 0.0, most_u_s, unit),
        out_of_range("the direction", goal.direction_rad, -math.tau, math.tau, "rad"),
    ):
        if why:
            raise ValueError(f"{why}: check the unit")
    velocity_u_s = min(goal.velocity_u_s or most_u_s, most_u_s)
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
    """Return why the odometry cannot be used; None: it can."""
    if not stamp_is_fresh(now_ns, snapshot.stamp_ns, stale_s):
        return "the loop has stopped publishing its state"
    if any(joint.stale for joint in snapshot.joints):
        return "the odometry is stale: a wheel sends no feedback"
    if not stamp_is_fresh(now_ns, snapshot.odometry_stamp_ns, stale_s):
        return "the odometry is stale"
    pose = (snapshot.x_m, snapshot.y_m, snapshot.heading_rad)
    return None if all(map(math.isfinite, pose)) else "the odometry is not a number"


def obstacle(snapshot: Snapshot) -> str | None:
    """Return why nothing may move now; None: the base may move."""
    if snapshot.faults:
        return f"a fault is latched: {', '.join(snapshot.faults)}"
    if not snapshot.armed:
        return "it is not armed"
    if "stop_requested" in snapshot.reasons:
        return "a stop was requested"
    return None


class Travel:
    """Signed distance in a fixed direction of the base, and signed angle, since a start."""

    def __init__(self, start: Snapshot, direction_rad: float = 0.0) -> None:
        self._last = start
        self._direction_rad = direction_rad
        self.distance_m = 0.0
        self.angle_rad = 0.0

    def add(self, snapshot: Snapshot) -> str | None:
        """Add the motion since the last snapshot. Returns why the distance is no longer known;
        None: it is known."""
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
    """The command to send now. With `end` set, it is the last one of the motion."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0
    lateral_m_s: float = 0.0
    end: End | None = None
    why: str = ""


class Motion:
    """One goal in progress. Call `step` repeatedly with the newest snapshot."""

    def __init__(
        self, plan: Plan, start: Snapshot, now_ns: int, *, lease: int, stale_s: float, stops: int
    ) -> None:
        """`lease`: the number of the lease under which the commands are sent. `stale_s`: older
        states are not used. `stops`: the daemon's count of stops before the motion."""
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
        """Distance or angle done so far, with its sign."""
        return self.travel.distance_m if self.plan.axis == "linear" else self.travel.angle_rad

    @property
    def remaining_u(self) -> float:
        """Distance or angle still to go; negative behind the goal."""
        return math.copysign(1.0, self.plan.distance_u) * (self.plan.distance_u - self.distance_u)

    def cancel(self, now_ns: int) -> None:
        """Come to rest and end the motion there."""
        self._end(End.CANCELED, "canceled", now_ns)

    def counted(self, stops: int, asked_ns: int) -> None:
        """Take the daemon's count of stops, requested at `asked_ns`. The state page shows a stop
        only until the robot rests, so it may miss a short one between two looks."""
        if stops != self._stops:
            self._stopped = True
        else:
            self._unstopped_ns = asked_ns

    def step(self, snapshot: Snapshot, now_ns: int) -> MotionStep:
        """Return the step that follows from this snapshot."""
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
        """Return why the motion has to end at once; None: it goes on."""
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
        """Begin to end the motion; only the first reason counts."""
        if self._ending is None:
            self._ending, self._ending_ns = (how, why), now_ns

    def _stuck(self, now_ns: int) -> bool:
        """Return whether the base has come no nearer for too long. Progress counts from a quarter
        of the distance that it creeps in STUCK_S, or of the tolerance if that is less."""
        plan, bounds = self.plan, self.plan.bounds
        step_u = min(plan.tolerance_u, self._creep_u_s() * STUCK_S) / 4.0
        if abs(self.remaining_u) <= self._near_u - step_u:
            self._near_u, self._near_ns = abs(self.remaining_u), now_ns
        starts_s = plan.velocity_u_s / bounds.acceleration_u_s2
        starts_s += bounds.acceleration_u_s2 / bounds.jerk_u_s3
        return (now_ns - self._near_ns) * _NS > STUCK_S + starts_s

    def _creep_u_s(self) -> float:
        """Return the speed from which the base stops within half of the tolerance, limited by the
        plan."""
        creep_u_s = self.plan.bounds.approach_u_s(self.plan.tolerance_u / 2.0)
        return min(creep_u_s, self.plan.velocity_u_s)

    def _onward(self) -> MotionStep:
        """Return the step towards the goal, not slower than the creep speed, so that it arrives."""
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
                return MotionStep(end=End.ABORTED, why="it was not seen to come to rest")
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
        """Begin a correction towards the goal. False: it is too far, or there were too many."""
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
