# SPDX-License-Identifier: Apache-2.0
"""ramp_step: the guarantees of a ramp, for any number that a double can hold."""

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
"""Limits of the axes that stand."""


@dataclass
class Axis:
    """One of the three axes that `ramp_step` moves; the others stand."""

    acceleration: float = 1.0
    deceleration: float = 1.5
    jerk: float = 8.0
    dt: float = 0.001
    index: int = lib.AXIS_LINEAR
    both: object = field(default_factory=lambda: ffi.new("limit_state[3]"))

    @property
    def state(self):
        return self.both[self.index]

    def step(self, want: float, *, urgent: bool = False) -> float:
        own = (100.0, self.acceleration, self.deceleration, self.jerk)
        rows = [REST] * lib.AXES
        rows[self.index] = own
        goal = [0.0] * lib.AXES
        goal[self.index] = want
        limits = ffi.new("base_limits *", rows)
        lib.ramp_step(self.both, lib.AXES, limits, ffi.NULL, goal, self.dt, urgent)
        return self.state.velocity_u_s

    def until(self, want: float) -> list[float]:
        """Step until the goal is reached; return all velocities."""
        found = [self.state.velocity_u_s]
        while found[-1] != want or self.state.acceleration_u_s2 != 0.0:
            found.append(self.step(want))
            assert len(found) < 100_000, "never arrives"
        return found


AXES = st.sampled_from([lib.AXIS_LINEAR, lib.AXIS_ANGULAR, lib.AXIS_LATERAL])
axes = st.builds(Axis, POSITIVE, POSITIVE, JERK, DT, AXES)


def used_s(axis: Axis, before: float, after: float) -> float:
    """Return the least time of the step: down to zero with the deceleration, up again with the
    acceleration."""
    if before * after < 0.0:
        return abs(before) / axis.deceleration + abs(after) / axis.acceleration
    bound = axis.acceleration if abs(after) > abs(before) else axis.deceleration
    return abs(after - before) / bound


@given(axes, st.lists(SPEED, min_size=1, max_size=30))
def test_no_limit_is_exceeded_and_no_goal_overshot_for_any_goals(axis, goals):
    before = 0.0
    for goal in goals:
        for _ in range(5):
            after = axis.step(goal)
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


@pytest.mark.parametrize("other", [0.0, 1.0, -1.0])
@given(axes, SPEED, st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_goal_that_is_not_finite_is_a_goal_of_zero(other, axis, start, want):
    axis.state.velocity_u_s = start
    axis.both[(axis.index + 1) % lib.AXES].velocity_u_s = other
    velocity = axis.step(want)
    assert abs(velocity) <= abs(start)
    assert velocity * start >= 0.0


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
def test_the_result_is_finite_for_any_input(numbers, start, want, urgent):
    axis = Axis(*numbers)
    axis.state.velocity_u_s, axis.state.acceleration_u_s2 = start
    axis.step(want, urgent=urgent)
    for one in axis.both:
        assert math.isfinite(one.velocity_u_s)
        assert math.isfinite(one.acceleration_u_s2)
