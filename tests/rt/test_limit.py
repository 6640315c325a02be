# SPDX-License-Identifier: Apache-2.0
"""limit_step: what is promised of a ramp, for any number that a double can hold."""

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


@dataclass
class Axis:
    velocity: float = 1.0
    acceleration: float = 1.0
    deceleration: float = 1.5
    jerk: float = 8.0
    dt: float = 0.001
    state: object = field(default_factory=lambda: ffi.new("limit_state *"))

    def step(self, want: float, *, urgent: bool = False) -> tuple[float, int]:
        limits = ffi.new(
            "axis_limits *", (self.velocity, self.acceleration, self.deceleration, self.jerk)
        )
        out = lib.limit_step(self.state, limits, want, self.dt, urgent)
        return out.velocity_u_s, out.reasons

    def until(self, want: float) -> list[float]:
        """All velocities until the wish is reached."""
        found = [self.state.velocity_u_s]
        while found[-1] != want or self.state.acceleration_u_s2 != 0.0:
            found.append(self.step(want)[0])
            assert len(found) < 100_000, "never arrives"
        return found


axes = st.builds(Axis, POSITIVE, POSITIVE, POSITIVE, JERK, DT)


def bound(axis: Axis, before: float, after: float) -> float:
    """The acceleration allowed between two velocities on the same side of zero."""
    return axis.acceleration if abs(after) > abs(before) else axis.deceleration


@given(axes, st.lists(SPEED, min_size=1, max_size=30))
def test_no_limit_is_exceeded_and_no_wish_overshot_whatever_the_wishes(axis, wishes):
    before = 0.0
    for want in wishes:
        goal = max(-axis.velocity, min(axis.velocity, want))
        after, _ = axis.step(want)
        assert abs(after) <= axis.velocity
        assert min(before, goal) <= after <= max(before, goal)
        assert abs(after - before) <= bound(axis, before, after) * axis.dt * (1 + TINY) + 1e-15
        before = after


@given(axes, SPEED, SPEED)
def test_the_jerk_is_kept_ramping_in_and_easing_off(axis, start, want):
    axis.velocity = 10.0
    axis.dt = 0.01
    axis.acceleration, axis.deceleration = axis.acceleration + 0.5, axis.deceleration + 0.5
    axis.jerk += 1.0
    axis.state.velocity_u_s = start
    before = 0.0
    for _ in axis.until(want)[1:]:
        after = axis.state.acceleration_u_s2
        assert abs(after - before) <= axis.jerk * axis.dt * (1 + TINY)
        before = after


def test_a_ramp_takes_the_time_that_the_textbook_gives():
    axis = Axis(velocity=1.0, acceleration=1.0, jerk=8.0, dt=0.001)
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


@given(axes, SPEED, SPEED)
def test_through_zero_the_axis_brakes_first_and_then_accelerates(axis, start, want):
    axis.velocity = 10.0
    axis.state.velocity_u_s = start
    before = start
    for _ in range(50):
        after, _ = axis.step(want)
        assert before * after >= 0.0, "zero is touched, never jumped over"
        before = after


def test_braking_uses_the_deceleration_and_starting_the_acceleration():
    axis = Axis(acceleration=1.0, deceleration=4.0, jerk=math.inf, dt=0.01)
    axis.state.velocity_u_s = 0.08
    assert axis.step(-1.0) == (pytest.approx(0.04), lib.REASON_LINEAR_DECELERATION)
    assert axis.step(-1.0) == (0.0, lib.REASON_LINEAR_DECELERATION)
    assert axis.step(-1.0) == (pytest.approx(-0.01), lib.REASON_LINEAR_ACCELERATION)


def test_each_reason_names_the_limit_that_bound():
    axis = Axis(velocity=0.5, acceleration=1.0, deceleration=1.5, jerk=8.0, dt=0.01)
    seen = []
    for want in [2.0] * 100 + [0.0] * 100:
        reason = axis.step(want)[1]
        if not seen or seen[-1] != reason:
            seen.append(reason)
    velocity, jerk = lib.REASON_LINEAR_VELOCITY, lib.REASON_LINEAR_JERK
    assert seen == [
        velocity | jerk,
        velocity | lib.REASON_LINEAR_ACCELERATION,
        velocity | jerk,
        velocity,
        jerk,
        lib.REASON_LINEAR_DECELERATION,
        jerk,
        0,
    ]


def test_a_lowered_velocity_limit_is_reached_by_braking_and_not_by_a_jump():
    axis = Axis(velocity=2.0)
    axis.until(2.0)
    axis.velocity = 0.5
    first, reasons = axis.step(2.0)
    assert 2.0 - axis.deceleration * axis.dt <= first < 2.0
    assert reasons & lib.REASON_LINEAR_VELOCITY
    before = first
    while axis.state.velocity_u_s != 0.5:
        after = axis.step(2.0)[0]
        assert 0.5 <= after <= before
        before = after


def test_a_limit_that_was_practically_off_binds_as_soon_as_it_is_set():
    axis = Axis(velocity=1e9, acceleration=1e9, deceleration=1e9, jerk=math.inf)
    assert axis.step(5.0)[0] == 5.0
    axis.velocity = axis.acceleration = axis.deceleration = 0.5
    for _ in range(20_000):
        velocity, _ = axis.step(5.0)
    assert velocity == 0.5


def test_urgent_leaves_the_jerk_limit_out():
    axis = Axis(jerk=0.1, dt=0.01)
    axis.state.velocity_u_s = 1.0
    velocity, reasons = axis.step(0.0, urgent=True)
    assert velocity == pytest.approx(1.0 - 1.5 * 0.01)
    assert reasons == lib.REASON_LINEAR_DECELERATION


@given(axes, SPEED, st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_wish_that_is_no_number_is_a_wish_for_zero(axis, start, want):
    axis.velocity = 10.0
    axis.state.velocity_u_s = start
    velocity, _ = axis.step(want)
    assert abs(velocity) <= abs(start)
    assert velocity * start >= 0.0


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["velocity_u_s", "acceleration_u_s2"])
def test_a_state_that_is_no_number_is_rest_at_once(name, broken):
    axis = Axis()
    axis.state.velocity_u_s = 0.5
    setattr(axis.state, name, broken)
    assert axis.step(1.0)[0] == 0.0
    assert (axis.state.velocity_u_s, axis.state.acceleration_u_s2) == (0.0, 0.0)


@pytest.mark.parametrize("dt", [0.0, -0.001, math.nan, math.inf, -math.inf])
def test_a_step_without_a_length_is_rest(dt):
    axis = Axis(dt=dt)
    axis.state.velocity_u_s = 0.5
    assert axis.step(1.0) == (0.0, 0)


@given(
    numbers=st.tuples(ANY, ANY, ANY, ANY, ANY),
    start=st.tuples(ANY, ANY),
    want=ANY,
    urgent=st.booleans(),
)
@example(numbers=(5e-324, 1.0, 1.0, 5e-324, 1e-3), start=(0.5, 0.0), want=0.0, urgent=False)
@example(numbers=(math.nan, 1.0, 1.0, 1.0, 1e-3), start=(0.5, 0.0), want=1.0, urgent=False)
@example(numbers=(1.0, math.nan, math.nan, 1.0, 1e-3), start=(0.5, 0.0), want=1.0, urgent=False)
def test_no_number_whatsoever_makes_the_result_other_than_finite(numbers, start, want, urgent):
    axis = Axis(*numbers)
    axis.state.velocity_u_s, axis.state.acceleration_u_s2 = start
    result, _ = axis.step(want, urgent=urgent)
    assert math.isfinite(result)
    assert math.isfinite(axis.state.velocity_u_s)
    assert math.isfinite(axis.state.acceleration_u_s2)
    assert result == axis.state.velocity_u_s


def test_no_negative_zero_leaves_the_ramp():
    axis = Axis()
    velocity, _ = axis.step(-0.0)
    assert math.copysign(1.0, velocity) == 1.0
