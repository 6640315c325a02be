# SPDX-License-Identifier: Apache-2.0
"""A motion over a given distance: the speeds that it requests, and when and why it ends."""

import dataclasses
import math
import re
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.messages.bus_views import joint, view

from motord.api.motion import COMMANDS_WITHIN_S, Bounds, End, Goal, Motion, MotionStep, planned

LEASE, STALE_S, STEP_MS = 7, 0.25, 20
BOUNDS = Bounds(velocity_u_s=0.5, acceleration_u_s2=0.5, deceleration_u_s2=0.8, jerk_u_s3=math.inf)


def state(at_ms, **changes):
    fields = {"armed": True, "owner": LEASE, "at_rest": False}
    return view(at_ms, **(fields | changes)).snapshot


class Base:
    """A base that follows commands like the core: by ramps, `late_steps` steps late."""

    def __init__(self, axis, bounds, late_steps):
        self.axis, self.bounds = axis, bounds
        self.speed_u_s, self.distance_u, self.at_ms = 0.0, 0.0, 1
        self.fastest_u_s = 0.0
        self._requested = deque([0.0] * late_steps, late_steps + 1)
        self.stops = 0

    def follow(self, step):
        assert (step.linear_m_s, step.angular_rad_s)[self.axis == "linear"] == 0.0
        self._requested.append(step.linear_m_s + step.angular_rad_s)
        away_u_s = self._requested[0] - self.speed_u_s
        faster = abs(self._requested[0]) > abs(self.speed_u_s)
        rate = self.bounds.acceleration_u_s2 if faster else self.bounds.deceleration_u_s2
        step_u_s = rate * STEP_MS / 1000.0
        self.speed_u_s += max(-step_u_s, min(step_u_s, away_u_s))
        self.distance_u += self.speed_u_s * STEP_MS / 1000.0
        self.fastest_u_s = max(self.fastest_u_s, abs(self.speed_u_s))
        self.at_ms += STEP_MS

    def snapshot(self, **changes):
        pose = {"x_m": self.distance_u}
        if self.axis == "angular":
            pose = {"heading_rad": math.remainder(self.distance_u, math.tau)}
        resting = self.speed_u_s == 0.0 and not any(self._requested)
        return state(self.at_ms, **({"at_rest": resting} | pose | changes))


def begun(goal, bounds=BOUNDS, late_steps=2):
    base = Base(goal.axis, bounds, late_steps)
    motion = Motion(
        planned(goal, bounds), base.snapshot(), 0, lease=LEASE, stale_s=STALE_S, stops=0
    )
    return base, motion


def looked(base, motion):
    """Pass the present count of stops to the motion; return its next step."""
    motion.counted(base.stops, base.at_ms * 1_000_000)
    return motion.step(base.snapshot(), base.at_ms * 1_000_000)


def carried_out(base, motion, steps_max=100_000):
    for _ in range(steps_max):
        step = looked(base, motion)
        if step.end is not None:
            return step
        base.follow(step)
    raise AssertionError("the motion does not end")


@settings(max_examples=60, deadline=None)
@given(
    axis=st.sampled_from(["linear", "angular"]),
    distance_u=st.floats(0.05, 20.0).flatmap(lambda u: st.sampled_from([u, -u])),
    velocity_u_s=st.floats(0.05, 2.0),
    acceleration_u_s2=st.floats(0.1, 5.0),
    deceleration_u_s2=st.floats(0.1, 5.0),
    late_steps=st.integers(0, 4),
)
def test_a_motion_ends_within_its_tolerance_and_its_speed(
    axis, distance_u, velocity_u_s, acceleration_u_s2, deceleration_u_s2, late_steps
):
    bounds = Bounds(
        velocity_u_s=velocity_u_s,
        acceleration_u_s2=acceleration_u_s2,
        deceleration_u_s2=deceleration_u_s2,
        jerk_u_s3=math.inf,
    )
    base, motion = begun(Goal(axis=axis, distance_u=distance_u), bounds, late_steps)
    step = carried_out(base, motion)
    assert (step.end, step.why) == (End.SUCCEEDED, "")
    assert abs(base.distance_u - distance_u) <= motion.plan.tolerance_u
    assert base.speed_u_s == 0.0
    assert base.fastest_u_s <= velocity_u_s * (1.0 + 1e-9)


def test_the_requested_speed_counts_where_it_is_less_than_the_limit():
    base, motion = begun(Goal(axis="linear", distance_u=1.0, velocity_u_s=0.1))
    carried_out(base, motion)
    assert base.fastest_u_s == pytest.approx(0.1)
    base, motion = begun(Goal(axis="linear", distance_u=2.0, velocity_u_s=0.5005))
    carried_out(base, motion)
    assert base.fastest_u_s == pytest.approx(BOUNDS.velocity_u_s)


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"velocity_u_s": 0.502}, "the speed = 0.502 is beyond its range, 0 to 0.5 m/s"),
        ({"axis": "angular", "velocity_u_s": 30.0}, "30 is beyond its range, 0 to 0.5 rad/s"),
        ({"direction_rad": 90.0}, "the direction = 90 is beyond its range, -6.28319 to 6.28319"),
    ],
)
def test_a_speed_and_a_direction_beyond_their_ranges_are_refused_with_range_and_unit(wrong, why):
    with pytest.raises(ValueError, match=re.escape(why)):
        planned(Goal(**{"axis": "linear", "distance_u": 1.0} | wrong), BOUNDS)


def test_a_turn_of_several_times_round_is_counted_whole():
    base, motion = begun(Goal(axis="angular", distance_u=-5.0 * math.tau))
    assert carried_out(base, motion).end is End.SUCCEEDED
    assert motion.travel.angle_rad == pytest.approx(-5.0 * math.tau, abs=0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        {"distance_u": 0.0}, {"distance_u": math.nan},
        {"distance_u": math.inf}, {"distance_u": 1001.0},
        {"velocity_u_s": -0.1}, {"velocity_u_s": math.nan}, {"tolerance_u": -0.01},
        {"timeout_s": -1.0}, {"timeout_s": math.inf}, {"timeout_s": 4000.0},
    ],
)  # fmt: skip
def test_an_invalid_goal_is_refused(wrong):
    with pytest.raises(ValueError):
        planned(Goal(**({"axis": "linear", "distance_u": 1.0} | wrong)), BOUNDS)


def moving():
    """Return a base and its motion at full speed."""
    base, motion = begun(Goal(axis="linear", distance_u=5.0))
    while base.speed_u_s < BOUNDS.velocity_u_s:
        base.follow(looked(base, motion))
    return base, motion


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"faults": ("estop",)}, "estop"),
        ({"armed": False}, "not armed"),
        ({"reasons": ("stop_requested",)}, "stop"),
        ({"owner": LEASE + 1}, "another source"),
        ({"owner": 0}, "no longer arrive"),
        ({"joints": (joint(), joint(stale=True))}, "stale"),
        ({"odometry_epoch": 1.0}, "reset"),
        ({"x_m": math.nan}, "not a number"),
        ({"odometry_stamp_ns": 1}, "stale"),
        ({"odometry_stamp_ns": 0}, "stale"),
        ({"odometry_stamp_ns": 100 * 10**9}, "stale"),
        ({"stamp_ns": 100 * 10**9}, "stopped publishing"),
    ],
)
def test_a_problem_ends_the_motion_at_once_with_a_command_of_zero(change, why):
    base, motion = moving()
    step = motion.step(base.snapshot(**change), base.at_ms * 1_000_000)
    assert step.end is End.ABORTED
    assert (step.linear_m_s, step.angular_rad_s) == (0.0, 0.0)
    assert why in step.why


def test_a_state_page_that_stands_still_ends_the_motion():
    base, motion = moving()
    newest = base.snapshot()
    just_ns = (base.at_ms + round(STALE_S * 1000)) * 1_000_000
    assert motion.step(newest, just_ns).end is None
    assert motion.step(newest, just_ns + 1_000_000).end is End.ABORTED


def test_a_motion_that_was_not_looked_at_for_long_is_aborted():
    base, motion = moving()
    base.at_ms += 901
    step = looked(base, motion)
    assert step.end is End.ABORTED
    assert "not read" in step.why


@pytest.mark.parametrize(("owner", "why"), [(0, "do not arrive"), (LEASE + 1, "another source")])
def test_a_motion_that_is_never_in_command_is_aborted(owner, why):
    _, motion = begun(Goal(axis="linear", distance_u=1.0))
    late_ms = round(COMMANDS_WITHIN_S * 1000)
    for at_ms in (late_ms // 2, late_ms):
        assert motion.step(state(at_ms, owner=owner), at_ms * 1_000_000).end is None
    step = motion.step(state(late_ms + 1, owner=owner), (late_ms + 1) * 1_000_000)
    assert step.end is End.ABORTED
    assert why in step.why


def test_a_cancelled_motion_comes_to_rest_and_then_ends():
    base, motion = moving()
    motion.cancel(base.at_ms * 1_000_000)
    step = looked(base, motion)
    assert step.end is None
    assert (step.linear_m_s, step.angular_rad_s) == (0.0, 0.0)
    step = carried_out(base, motion)
    assert (step.end, base.speed_u_s) == (End.CANCELED, 0.0)


def test_a_motion_that_takes_too_long_comes_to_rest_and_is_aborted():
    base, motion = begun(Goal(axis="linear", distance_u=5.0, timeout_s=2.0))
    step = carried_out(base, motion)
    assert step.end is End.ABORTED
    assert "longer than 2.0 s" in step.why
    assert base.speed_u_s == 0.0
    assert 0.0 < base.distance_u < 5.0


def test_a_blocked_base_is_not_pushed_for_long():
    base, motion = begun(Goal(axis="linear", distance_u=5.0, timeout_s=1000.0))
    while base.distance_u < 1.0:
        base.follow(looked(base, motion))
    held_ms = base.at_ms
    while looked(base, motion) != MotionStep():
        base.at_ms += STEP_MS
    assert 3000 < base.at_ms - held_ms < 5000
    base.speed_u_s = 0.0
    step = carried_out(base, motion)
    assert (step.end, step.why) == (End.ABORTED, "it is stuck")


def test_a_slow_base_does_not_count_as_stuck():
    slow = Bounds(
        velocity_u_s=0.002, acceleration_u_s2=0.001, deceleration_u_s2=0.001, jerk_u_s3=0.001
    )
    base, motion = begun(Goal(axis="linear", distance_u=0.05), slow)
    assert carried_out(base, motion).end is End.SUCCEEDED


def test_a_base_that_slides_past_the_goal_did_not_succeed():
    base, motion = begun(Goal(axis="linear", distance_u=1.0))
    base.distance_u = 1.2
    step = carried_out(base, motion)
    assert step.end is End.ABORTED
    assert "0.2 behind the goal" in step.why


@pytest.mark.parametrize("slip_u", [0.05, -0.05, 0.09])
def test_a_base_that_slips_by_a_little_goes_the_rest_of_the_distance(slip_u):
    base, motion = begun(Goal(axis="linear", distance_u=-1.0))
    while motion.remaining_u > 0.004:
        base.follow(looked(base, motion))
    base.distance_u += slip_u
    step = carried_out(base, motion)
    assert (step.end, step.why) == (End.SUCCEEDED, "")
    assert base.distance_u == pytest.approx(-1.0, abs=0.01)


def rested_beside_its_goal():
    """Return a base that rests beyond its goal (its wheels slid, or a stop was not seen), and its
    motion."""
    base, motion = begun(Goal(axis="linear", distance_u=1.0))
    while motion.remaining_u > 0.004:
        base.follow(looked(base, motion))
    base.distance_u += 0.05
    base.speed_u_s = 0.0
    return base, motion


def test_after_a_stop_that_was_over_before_it_was_seen_nothing_is_corrected():
    base, motion = rested_beside_its_goal()
    base.stops = 1
    step = carried_out(base, motion)
    assert (step.end, step.why) == (End.ABORTED, "a stop was requested")
    assert base.distance_u == pytest.approx(1.05, abs=0.01)


def test_a_stop_that_shows_only_in_the_count_ends_a_running_motion():
    base, motion = moving()
    base.stops = 1
    assert looked(base, motion) == MotionStep(end=End.ABORTED, why="a stop was requested")


@pytest.mark.parametrize("asked_before", [True, False])
def test_without_a_fresh_count_of_stops_nothing_is_corrected(asked_before):
    base, motion = rested_beside_its_goal()
    if asked_before:
        motion.counted(0, base.at_ms * 1_000_000)
    while (step := motion.step(base.snapshot(), base.at_ms * 1_000_000)).end is None:
        assert step == MotionStep()
        base.follow(step)
    assert step.end is End.ABORTED
    assert "behind the goal" in step.why


def test_a_base_that_slips_each_time_is_not_corrected_for_ever():
    base, motion = begun(Goal(axis="linear", distance_u=1.0))
    slips = 0
    while (step := looked(base, motion)).end is None:
        base.follow(step)
        if abs(motion.remaining_u) < 0.006 and base.speed_u_s == 0.0:
            base.distance_u += 0.05
            slips += 1
    assert step.end is End.ABORTED
    assert "behind the goal" in step.why
    assert slips == 4


def test_a_base_that_does_not_come_to_rest_is_not_waited_for_for_ever():
    base, motion = begun(Goal(axis="linear", distance_u=1.0))
    base.distance_u = 1.0
    for _ in range(2000):
        base.at_ms += STEP_MS
        step = motion.step(base.snapshot(at_rest=False), base.at_ms * 1_000_000)
        if step.end is not None:
            break
    assert (step.end, step.why) == (End.ABORTED, "it was not seen to come to rest")


def test_a_jerk_limit_makes_a_motion_slow_down_earlier():
    soft = dataclasses.replace(BOUNDS, jerk_u_s3=0.5)
    assert soft.approach_u_s(0.5) < BOUNDS.approach_u_s(0.5)
    assert BOUNDS.approach_u_s(-1.0) == 0.0
