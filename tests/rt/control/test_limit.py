# SPDX-License-Identifier: Apache-2.0
"""ramp_step: what is promised of a ramp, for any number that a double can hold."""

import math
from dataclasses import dataclass, field

import pytest
from _motord_rt import ffi, lib
from hypothesis import example, given
from hypothesis import strategies as st

ANY = st.floats(allow_nan=True, allow_infinity=True)
SPEED = st.floats(-5.0, 5.0)
POSITIVE = st.floats(0.01, 100.0)
JERK = st.one_of(st.floats(0.01, 1000.0), st.just(math.inf))
DT = st.floats(1e-4, 0.1)
TINY = 1e-9
REST = (1.0, 1.0, 1.0, 1.0)
"""The other axis, which stands."""


SHIFTS = {lib.AXIS_LINEAR: 0, lib.AXIS_ANGULAR: 4, lib.AXIS_LATERAL: 11}
"""Where the reasons of each begin, by those of the linear one."""


@dataclass
class Axis:
    """One axis of three; the reasons are those of the linear one."""

    acceleration: float = 1.0
    deceleration: float = 1.5
    jerk: float = 8.0
    dt: float = 0.001
    index: int = lib.AXIS_LINEAR
    both: object = field(default_factory=lambda: ffi.new("limit_state[3]"))

    @property
    def state(self):
        return self.both[self.index]

    def step(self, want: float, *, urgent: bool = False) -> tuple[float, int]:
        own = (100.0, self.acceleration, self.deceleration, self.jerk)
        rows = [REST] * lib.AXES
        rows[self.index] = own
        goal = [0.0] * lib.AXES
        goal[self.index] = want
        limits = ffi.new("base_limits *", rows)
        reasons = lib.ramp_step(self.both, lib.AXES, limits, ffi.NULL, goal, self.dt, urgent)
        return self.state.velocity_u_s, reasons >> SHIFTS[self.index]

    def until(self, want: float) -> list[float]:
        """All velocities until the goal is reached."""
        found = [self.state.velocity_u_s]
        while found[-1] != want or self.state.acceleration_u_s2 != 0.0:
            found.append(self.step(want)[0])
            assert len(found) < 100_000, "never arrives"
        return found


AXES = st.sampled_from([lib.AXIS_LINEAR, lib.AXIS_ANGULAR, lib.AXIS_LATERAL])
axes = st.builds(Axis, POSITIVE, POSITIVE, JERK, DT, AXES)


def used_s(axis: Axis, before: float, after: float) -> float:
    """How long the step takes at least: down to zero with the deceleration, up again with the
    acceleration."""
    if before * after < 0.0:
        return abs(before) / axis.deceleration + abs(after) / axis.acceleration
    bound = axis.acceleration if abs(after) > abs(before) else axis.deceleration
    return abs(after - before) / bound


@given(axes, st.lists(SPEED, min_size=1, max_size=30))
def test_no_limit_is_exceeded_and_no_goal_overshot_whatever_the_goals(axis, goals):
    before = 0.0
    for goal in goals:
        for _ in range(5):
            after, _ = axis.step(goal)
            assert min(before, goal) <= after <= max(before, goal)
            least = min(axis.acceleration, axis.deceleration)
            assert used_s(axis, before, after) <= axis.dt * (1 + TINY) + 4e-15 / least
            before = after


@given(axes, SPEED, SPEED)
@example(Axis(1.0, 8.0, 3.0, 0.01), 4.0, -4.0)
@example(Axis(8.0, 1.0, 3.0, 0.01), 4.0, -4.0)
def test_the_jerk_is_kept_ramping_in_easing_off_and_through_zero(axis, start, want):
    axis.dt = 0.01
    axis.acceleration, axis.deceleration = axis.acceleration + 0.5, axis.deceleration + 0.5
    axis.jerk += 1.0
    axis.state.velocity_u_s = start
    before = 0.0
    for _ in axis.until(want)[1:]:
        after = axis.state.acceleration_u_s2
        assert abs(after - before) <= axis.jerk * axis.dt * (1 + 1e-6) + 1e-11
        before = after


def test_a_ramp_takes_the_time_that_the_textbook_gives():
    axis = Axis(acceleration=1.0, jerk=8.0, dt=0.001)
    # v / a + a / j, Biagiotti & Melchiorri, Trajectory Planning, 3.4 (double S, no cruise)
    assert len(axis.until(1.0)) * axis.dt == pytest.approx(1.0 + 1.0 / 8.0, abs=0.005)


def test_a_small_change_never_reaches_the_acceleration_limit():
    axis = Axis(acceleration=10.0, jerk=1.0)
    reasons = set()
    while axis.state.velocity_u_s != 0.01:
        reasons.add(axis.step(0.01)[1])
    assert reasons == {lib.REASON_LINEAR_JERK, 0}


def test_infinite_jerk_is_a_plain_ramp():
    axis = Axis(jerk=math.inf, dt=0.01)
    assert axis.until(0.05) == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.05])


@given(axes, st.floats(0.1, 5.0))
def test_braking_through_zero_takes_no_longer_than_braking_to_zero(axis, start):
    axis.jerk = math.inf
    axis.dt = max(axis.dt, start / axis.deceleration / 1000.0)
    axis.state.velocity_u_s = start
    steps = 0
    while axis.state.velocity_u_s > 1e-9:
        axis.step(-5.0)
        steps += 1
    assert steps <= math.ceil(start / axis.deceleration / axis.dt * (1 + TINY))


def test_braking_uses_the_deceleration_and_starting_the_acceleration():
    axis = Axis(acceleration=1.0, deceleration=4.0, jerk=math.inf, dt=0.01)
    axis.state.velocity_u_s = 0.08
    assert axis.step(-1.0) == (pytest.approx(0.04), lib.REASON_LINEAR_DECELERATION)
    assert axis.step(-1.0)[0] == pytest.approx(0.0, abs=1e-12)
    assert axis.step(-1.0) == (pytest.approx(-0.01), lib.REASON_LINEAR_ACCELERATION)


def test_each_reason_names_the_limit_that_bound():
    axis = Axis(acceleration=1.0, deceleration=1.5, jerk=8.0, dt=0.01)
    seen = []
    for want in [0.5] * 100 + [0.0] * 100:
        reason = axis.step(want)[1]
        if not seen or seen[-1] != reason:
            seen.append(reason)
    jerk = lib.REASON_LINEAR_JERK
    assert seen == [
        jerk,
        lib.REASON_LINEAR_ACCELERATION,
        jerk,
        0,
        jerk,
        lib.REASON_LINEAR_DECELERATION,
        jerk,
        0,
    ]


def test_a_goal_below_the_speed_is_reached_by_braking_and_not_by_a_jump():
    axis = Axis()
    axis.until(2.0)
    first, reasons = axis.step(0.5)
    assert 2.0 - axis.deceleration * axis.dt <= first < 2.0
    assert reasons & lib.REASON_LINEAR_JERK
    before = first
    while axis.state.velocity_u_s != 0.5:
        after = axis.step(0.5)[0]
        assert 0.5 <= after <= before
        before = after


def test_limits_that_were_practically_off_bind_as_soon_as_they_are_set():
    axis = Axis(acceleration=1e9, deceleration=1e9, jerk=math.inf)
    assert axis.step(5.0)[0] == 5.0
    axis.acceleration = axis.deceleration = 0.5
    assert axis.step(0.5)[0] == pytest.approx(5.0 - 0.5 * axis.dt)


def test_urgent_leaves_the_jerk_limit_out():
    axis = Axis(jerk=0.1, dt=0.01)
    axis.state.velocity_u_s = 1.0
    velocity, reasons = axis.step(0.0, urgent=True)
    assert velocity == pytest.approx(1.0 - 1.5 * 0.01)
    assert reasons == lib.REASON_LINEAR_DECELERATION


@pytest.mark.parametrize("other", [0.0, 1.0, -1.0])
@given(axes, SPEED, st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_goal_that_is_no_number_is_a_goal_of_zero(other, axis, start, want):
    axis.state.velocity_u_s = start
    axis.both[(axis.index + 1) % lib.AXES].velocity_u_s = other
    velocity, _ = axis.step(want)
    assert abs(velocity) <= abs(start)
    assert velocity * start >= 0.0


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["velocity_u_s", "acceleration_u_s2"])
def test_a_state_that_is_no_number_is_rest_of_all_axes_at_once(name, broken):
    axis = Axis()
    for one in axis.both:
        one.velocity_u_s = 0.5
    setattr(axis.state, name, broken)
    assert axis.step(1.0)[0] == 0.0
    for one in axis.both:
        assert (one.velocity_u_s, one.acceleration_u_s2) == (0.0, 0.0)


@pytest.mark.parametrize("dt", [0.0, -0.001, math.nan, math.inf, -math.inf])
def test_a_step_without_a_length_is_rest(dt):
    axis = Axis(dt=dt)
    axis.state.velocity_u_s = 0.5
    assert axis.step(1.0) == (0.0, 0)


@given(
    numbers=st.tuples(ANY, ANY, ANY, ANY, AXES),
    start=st.tuples(ANY, ANY),
    want=ANY,
    urgent=st.booleans(),
)
@example(numbers=(1.0, 1.0, 5e-324, 1e-3, 0), start=(0.5, 0.0), want=0.0, urgent=False)
@example(numbers=(math.nan, math.nan, 1.0, 1e-3, 1), start=(0.5, 0.0), want=1.0, urgent=False)
@example(numbers=(1.0, 1.0, math.nan, 1e-3, 0), start=(0.5, 0.0), want=1.0, urgent=False)
@example(numbers=(0.0, 1.0, 1.0, 1e-3, 0), start=(0.5, 0.0), want=-1.0, urgent=False)
def test_no_number_whatsoever_makes_the_result_other_than_finite(numbers, start, want, urgent):
    axis = Axis(*numbers)
    axis.state.velocity_u_s, axis.state.acceleration_u_s2 = start
    axis.step(want, urgent=urgent)
    for one in axis.both:
        assert math.isfinite(one.velocity_u_s)
        assert math.isfinite(one.acceleration_u_s2)


def test_no_negative_zero_leaves_the_ramp():
    axis = Axis()
    velocity, _ = axis.step(-0.0)
    assert math.copysign(1.0, velocity) == 1.0
