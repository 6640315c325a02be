# SPDX-License-Identifier: Apache-2.0
"""A ramp takes the shortest time that its limits allow, from any state, and never overshoots.

The number of ticks may differ from that time, by so many ticks as are in parentheses. A profile in
continuous time, averaged over each tick, keeps the jerk from one tick to the next, so whole ticks
are enough: the last one is begun and not used up (1). A tick in which a speed passes zero keeps the
limits of both sides (1 for each axis that does so). In the other direction, straight lines between
the middles of the ticks keep the jerk and gain as much speed; they begin half a tick earlier and
end half a tick later (1), and where the limit changes with the sign, they may cut its corner (1).
"""

import math
from random import Random

import numpy as np
import pytest
from _motord_rt import ffi, lib
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rt.bases_oracle import rows_of
from tests.rt.core_rig import TICK_S, Rig, core_config, joint_config
from tests.rt.ramp_oracle import Bounds, Change, shortest_s, textbook_s
from tests.rt.steered_oracle import ROLLS, PositionRig

NAMES = ("acceleration_u_s2", "deceleration_u_s2", "jerk_u_s3")
FAST_U_S = 100.0
SLOWEST_TICKS = 50_000
ROUNDING_TICKS = 1e-3

UP = st.floats(0.5, 20.0)
JERK = st.one_of(st.floats(0.5, 500.0), st.just(math.inf))
BOUNDS = st.builds(Bounds, UP, UP, JERK)
SPEED = st.integers(-3000, 3000).map(lambda thousandths: thousandths / 1000.0)
ALONG = st.one_of(st.floats(-20.0, 20.0), st.just(0.0))
DT = st.sampled_from([0.002, 0.01, 0.02])
SEED = st.integers(0, 2**32)


def turns(changes):
    return sum(one.size_u_s > 0.0 and one.turn > 0.0 for one in changes)


def ticks_at_most(changes, dt_s):
    return shortest_s(*changes) / dt_s + 1 + turns(changes) + ROUNDING_TICKS


def ticks_at_least(changes, dt_s):
    return shortest_s(*changes) / dt_s - 1 - turns(changes) - ROUNDING_TICKS


def ramped(changes, dt_s):
    """Return how many ticks `ramp_step` needs; each axis must stay between its start and goal."""
    axes, goal = ffi.new("limit_state[3]"), [one.goal_u_s for one in changes]
    rows = [(FAST_U_S, *(getattr(one.bounds, name) for name in NAMES)) for one in changes]
    for axis, one in zip(axes, changes, strict=True):
        sense = math.copysign(1.0, one.goal_u_s - one.from_u_s)
        axis.velocity_u_s, axis.acceleration_u_s2 = one.from_u_s, sense * one.along_u_s2
    urgent = False
    limits, before = ffi.new("base_limits *", rows), [one.from_u_s for one in changes]
    for tick in range(SLOWEST_TICKS):
        if before == goal:
            return tick
        lib.ramp_step(axes, lib.AXES, limits, ffi.NULL, goal, dt_s, urgent)
        after = [axis.velocity_u_s for axis in axes]
        for was, now, end in zip(before, after, goal, strict=True):
            assert min(was, end) <= now <= max(was, end)
        before = after
    raise AssertionError(f"{before} and not {goal} after {SLOWEST_TICKS} ticks")


# -------------------------------------------------------------------------------------- the oracle
@given(st.floats(0.01, 5.0), UP, st.floats(0.5, 500.0))
def test_the_oracle_has_the_times_of_the_textbook(change_u_s, most_u_s2, jerk_u_s3):
    """Biagiotti & Melchiorri, 3.4.1, has formulae with and without the full acceleration."""
    reaches = change_u_s * jerk_u_s3 >= most_u_s2**2
    expected_s = (
        change_u_s / most_u_s2 + most_u_s2 / jerk_u_s3
        if reaches
        else 2.0 * math.sqrt(change_u_s / jerk_u_s3)
    )
    bounds = Bounds(most_u_s2, most_u_s2, jerk_u_s3)
    for from_u_s in (0.0, 1.0, -0.5 * change_u_s):
        found_s = shortest_s(Change(bounds, from_u_s, from_u_s + change_u_s))
        assert found_s == pytest.approx(expected_s, rel=1e-9)


@settings(max_examples=30)
@given(BOUNDS, BOUNDS, SPEED, SPEED, SPEED, SPEED, ALONG)
def test_the_oracle_has_the_time_of_a_forward_and_backward_pass(one, other, a, b, c, d, along):
    """Compare with the usual method to time a path under limits: on a fine grid, the highest speed
    that the start can lead to, then the highest from which the end can still be reached."""
    changes = [Change(one, a, b, along), Change(other, c, d, along)]
    moving = [x for x in changes if x.size_u_s > 0.05 and math.isfinite(x.bounds.jerk_u_s3)]
    if not moving:
        return
    share = np.linspace(0.0, 1.0, 200_001)
    middle = 0.5 * (share[1:] + share[:-1])
    most2 = np.min([np.vectorize(x.most_s)(middle) ** 2 for x in moving], axis=0)
    slope = 2.0 * min(x.bounds.jerk_u_s3 / x.size_u_s for x in moving)
    nodes2 = np.minimum(np.append(most2, np.inf), np.append(np.inf, most2))
    nodes2[0] = min(nodes2[0], min(max(x.along_u_s2, 0.0) / x.size_u_s for x in moving) ** 2)
    nodes2[-1] = 0.0
    forth = np.minimum.accumulate(nodes2 - slope * share) + slope * share
    back = np.minimum.accumulate((forth + slope * share)[::-1])[::-1] - slope * share
    rates = np.sqrt(np.maximum(back, 0.0))
    swept_s = float(np.sum(2.0 * np.diff(share) / (rates[1:] + rates[:-1])))
    assert shortest_s(*moving) == pytest.approx(swept_s, rel=2e-3)


@given(BOUNDS, SPEED, SPEED, ALONG)
def test_dropping_an_acceleration_takes_no_longer_than_ramping_it_down(bounds, start, goal, along):
    least = min(bounds.acceleration_u_s2, bounds.deceleration_u_s2)
    change = Change(bounds, start, goal, max(-least, min(along, least)))
    assert shortest_s(change) <= textbook_s(change) * (1.0 + 1e-9) + 1e-12


# --------------------------------------------------------------------------------------- the ramp
@given(BOUNDS, SPEED, SPEED, ALONG, DT, st.integers(0, 2))
def test_one_axis_takes_the_shortest_time_from_any_speed_and_acceleration(
    bounds, start, goal, along, dt_s, place
):
    stands = Change(bounds, 0.0, 0.0)
    changes = [stands] * 3
    changes[place] = Change(bounds, start, goal, along)
    ticks = ramped(changes, dt_s)
    if start != goal:
        assert ticks_at_least(changes, dt_s) <= ticks <= ticks_at_most(changes, dt_s)


CHANGE = st.builds(Change, BOUNDS, SPEED, SPEED, ALONG)


@given(st.tuples(CHANGE, CHANGE, CHANGE), DT)
def test_no_straight_line_to_a_twist_is_shorter_in_time(changes, dt_s):
    assert ramped(changes, dt_s) <= ticks_at_most(changes, dt_s)


@given(st.tuples(CHANGE, CHANGE, CHANGE), DT)
def test_from_a_steady_twist_neither_limit_nor_jerk_is_stretched(changes, dt_s):
    steady = [Change(one.bounds, one.from_u_s, one.goal_u_s) for one in changes]
    assert ticks_at_least(steady, dt_s) <= ramped(steady, dt_s)


# --------------------------------------------------------------------------------------- the core
def axis(velocity_u_s, bounds):
    return {"velocity_u_s": velocity_u_s, **{name: getattr(bounds, name) for name in NAMES}}


def bounds_of(limits):
    return Bounds(*(getattr(limits, name) for name in NAMES))


class Mecanum(Rig):
    """A base whose wheels are faster than any twist, so that the limits of the base alone count."""

    def __init__(self, limits):
        joints = [
            joint_config(
                0.0,
                row=dict(zip(("x", "y", "lever_m"), map(float, row), strict=True)),
                velocity_min_rad_s=-1e3,
                velocity_max_rad_s=1e3,
            )
            for row in rows_of("mecanum")
        ]
        super().__init__(core_config(4, joint=joints, limits=limits))
        self.arm()

    @property
    def limits(self):
        limits = self.input.control.limits
        return [limits.linear, limits.angular, limits.lateral]

    def speeds_u_s(self):
        shown = self.shown
        setpoints = shown.setpoint_linear_m_s, shown.setpoint_angular_rad_s
        return [*setpoints, shown.lateral.setpoint_lateral_m_s]

    def goals_u_s(self):
        command = self.input.command
        wanted = command.linear_m_s, command.angular_rad_s, command.lateral_m_s
        return [
            math.copysign(min(abs(want), one.velocity_u_s), want)
            for want, one in zip(wanted, self.limits, strict=True)
        ]

    def changes(self):
        rows = zip(self.state.axis, self.goals_u_s(), self.limits, strict=True)
        return [
            Change(
                bounds_of(limits),
                at.velocity_u_s,
                goal,
                math.copysign(1.0, goal - at.velocity_u_s) * at.acceleration_u_s2,
            )
            for at, goal, limits in rows
        ]

    def checked_tick(self):
        before, goals = self.speeds_u_s(), self.goals_u_s()
        self.tick()
        for was, now, goal in zip(before, self.speeds_u_s(), goals, strict=True):
            assert min(was, goal) <= now <= max(was, goal)


def disturbed(rig, place, chance):
    """Change goals and limits at random while the base moves, also to below its speed."""
    names = ("linear_m_s", "angular_rad_s", "lateral_m_s")
    for _ in range(chance.randint(1, 6)):
        if chance.random() < 0.5:
            for name, most in zip(NAMES, (20.0, 20.0, 400.0), strict=True):
                setattr(rig.limits[place], name, most * chance.uniform(0.02, 1.0))
            rig.limits[place].velocity_u_s = chance.uniform(0.1, 3.0)
        setattr(rig.input.command, names[place], chance.choice([0.0, chance.uniform(-3.0, 3.0)]))
        for _ in range(chance.choice([1, 3, 30, 300])):
            rig.checked_tick()


@pytest.mark.parametrize("place", [lib.AXIS_LINEAR, lib.AXIS_ANGULAR, lib.AXIS_LATERAL])
@settings(max_examples=25)
@given(BOUNDS, SEED)
def test_the_last_goal_under_the_last_limits_is_reached_in_the_shortest_time(place, bounds, seed):
    chance = Random(seed)
    limits = {name: axis(3.0, bounds) for name in ("linear", "angular", "lateral")}
    rig = Mecanum(limits)
    disturbed(rig, place, chance)
    changes = rig.changes()
    most = ticks_at_most(changes, TICK_S)
    ticks = 0
    while rig.speeds_u_s() != rig.goals_u_s():
        rig.checked_tick()
        ticks += 1
        assert ticks <= most
    assert ticks >= ticks_at_least(changes, TICK_S)


@settings(max_examples=25)
@given(BOUNDS, SEED)
def test_a_joint_without_a_base_takes_the_shortest_time(bounds, seed):
    chance, most_rad_s = Random(seed), 40.0
    joint = ROLLS | {"own": axis(most_rad_s, bounds)}
    rig = PositionRig(core_config(1, joint=[joint], joint_count=1, independent=1))
    rig.arm()
    rig.input.joints.named = 1
    before, goal, ticks, most, least = 0.0, 0.0, 0, 0.0, 0.0
    for _ in range(chance.randint(1, 6)):
        goal = rig.input.joints.value_u[0] = chance.choice([0.0, chance.uniform(-30.0, 30.0)])
        toward = math.copysign(1.0, goal - before) * rig.state.joints.acceleration_rad_s2[0]
        change = Change(bounds, before, goal, toward)
        ticks, most, least = 0, ticks_at_most([change], TICK_S), ticks_at_least([change], TICK_S)
        for _ in range(chance.choice([1, 3, 30, 300])):
            rig.tick()
            after = rig.speeds[0]
            assert min(before, goal) <= after <= max(before, goal)
            ticks += after != before
            before = after
    while before != goal:
        rig.tick()
        assert min(before, goal) <= rig.speeds[0] <= max(before, goal)
        before, ticks = rig.speeds[0], ticks + 1
        assert ticks <= most
    assert ticks >= least
