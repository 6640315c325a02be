# SPDX-License-Identifier: Apache-2.0
"""The ramp of the twist to a goal keeps the limits of the body and of every wheel in every tick."""

import math
from itertools import pairwise
from random import Random
from typing import Any

import pytest
from _motord_rt import lib
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rt.core_rig import TICK_S, TRACK_M, Rig, core_config, joint_config

RADIUS_M = 0.1
TINY = 1e-9
ROUNDING_U_S = 1e-13
"""Rounding error of a velocity: a few units in the last place."""
ROUNDING_U_S2 = 2.0 * ROUNDING_U_S / TICK_S


def axis(velocity: float, acceleration: float, deceleration: float, jerk: float = math.inf) -> Any:
    return {
        "velocity_u_s": velocity,
        "acceleration_u_s2": acceleration,
        "deceleration_u_s2": deceleration,
        "jerk_u_s3": jerk,
    }


def base(linear: Any, angular: Any, low: float = -15.0, high: float = 15.0, **pwm: float) -> Rig:
    """Return an armed base with two driven wheels."""
    joints = []
    for side in (-1.0, 1.0):
        joint = joint_config(side, velocity_min_rad_s=low, velocity_max_rad_s=high)
        joint["pwm"] = joint["pwm"] | pwm
        joints.append(joint)
    limits = {"linear": linear, "angular": angular, "lateral": linear}
    rig = Rig(core_config(joint=joints, limits=limits))
    rig.arm()
    return rig


def twist(rig: Rig) -> tuple[float, float]:
    return rig.shown.setpoint_linear_m_s, rig.shown.setpoint_angular_rad_s


def arrives(rig: Rig, goal: tuple[float, float], seconds: float = 60.0) -> None:
    for _ in range(round(seconds / TICK_S)):
        rig.tick()
        if twist(rig) == goal:
            rig.tick()
            return
    raise AssertionError(f"{twist(rig)} and not {goal} after {seconds} s")


def aim_of(rig: Rig) -> tuple[float, float]:
    goal = rig.state.goal
    if rig.input.control.stop or not rig.shown.armed or goal.zero:
        return 0.0, 0.0
    return goal.goal_u_s[lib.AXIS_LINEAR], goal.goal_u_s[lib.AXIS_ANGULAR]


class Judge:
    """Runs a base tick by tick and checks each tick against every limit of body and wheels."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.before = twist(rig)
        self.wheels = list(rig.speeds)
        self.acceleration = [0.0, 0.0]
        self.aim: Any = None

    @property
    def limits(self) -> list[Any]:
        limits = self.rig.input.control.limits
        return [limits.linear, limits.angular]

    def tick(self, *, urgent: bool = False) -> tuple[float, float]:
        rig = self.rig
        rig.tick()
        after = twist(rig)
        goal = aim_of(rig)
        aim = (goal, [tuple(getattr(a, n) for n in axis(0, 0, 0)) for a in self.limits], urgent)
        for i in range(2):
            self._axis(i, self.before[i], after[i], goal[i], turned=aim != self.aim, urgent=urgent)
        self._line(after, goal)
        self._wheels(after)
        self.before, self.wheels, self.aim = after, list(rig.speeds), aim
        return after

    def _axis(
        self, i: int, before: float, after: float, goal: float, *, turned: bool, urgent: bool
    ) -> None:
        limits = self.limits[i]
        assert abs(after) <= max(limits.velocity_u_s, abs(before))
        assert min(before, goal) <= after <= max(before, goal), "overshoot, or away from the goal"
        falls = abs(before) if before * after < 0.0 else max(abs(before) - abs(after), 0.0)
        grows = abs(after) if before * after < 0.0 else max(abs(after) - abs(before), 0.0)
        used_s = falls / limits.deceleration_u_s2 + grows / limits.acceleration_u_s2
        least = min(limits.deceleration_u_s2, limits.acceleration_u_s2)
        assert used_s <= TICK_S * (1.0 + TINY) + ROUNDING_U_S / least
        now, last = (after - before) / TICK_S, self.acceleration[i]
        self.acceleration[i] = now
        step = limits.jerk_u_s3 * TICK_S * (1.0 + 1e-6) + ROUNDING_U_S2
        if urgent:
            return
        assert abs(now) <= (abs(last) if now * last > 0.0 else 0.0) + step, "grows"
        if not turned:
            assert abs(now - last) <= step, "falls"

    def _line(self, after: tuple[float, float], goal: tuple[float, float]) -> None:
        done = [after[i] - self.before[i] for i in range(2)]
        left = [goal[i] - self.before[i] for i in range(2)]
        assert abs(done[0] * left[1] - done[1] * left[0]) <= 4.0 * ROUNDING_U_S

    def _wheels(self, after: tuple[float, float]) -> None:
        rig = self.rig
        linear, angular = self.limits
        most = [max(a.acceleration_u_s2, a.deceleration_u_s2) for a in (linear, angular)]
        most_m_s2 = most[0] + most[1] * TRACK_M / 2.0
        for j, speed in enumerate(rig.speeds):
            joint = rig.config.joint[j]
            assert joint.velocity_min_rad_s <= speed <= joint.velocity_max_rad_s
            twist_m_s = after[0] + joint.row.lever_m * after[1]
            assert speed * RADIUS_M == pytest.approx(twist_m_s, abs=1e-12)
            done_m_s = abs(speed - self.wheels[j]) * RADIUS_M
            assert done_m_s <= most_m_s2 * TICK_S * (1.0 + TINY) + ROUNDING_U_S

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def rest(self, within_s: float, *, urgent: bool = False) -> int:
        """Tick until the base rests; return the number of ticks. The curvature must stay."""
        start = self.before
        scale = max(abs(start[0]), abs(start[1]), 1e-300)
        for ticks in range(round(within_s / TICK_S) + 1):
            if self.before == (0.0, 0.0):
                return ticks
            after = self.tick(urgent=urgent)
            cross = after[0] * start[1] - after[1] * start[0]
            assert abs(cross) <= 1e-12 * scale, "the curvature changed"
        raise AssertionError(f"{self.before} after {within_s} s")


# ---------------------------------------------------------------------------------- earlier defects
def test_a_stop_in_a_curve_on_wheels_that_cannot_reverse_brakes_within_its_limits():
    rig = base(axis(1.0, 1.0, 1.5), axis(2.0, 3.0, 0.8), low=0.0)
    rig.drive(0.5, 1.9)
    arrives(rig, (0.5, 1.9))
    rig.input.control.stop = 1
    Judge(rig).rest(5.0)


def test_a_feasible_curve_starts_on_wheels_that_cannot_reverse():
    rig = base(axis(1.0, 0.5, 0.5), axis(2.0, 3.0, 3.0), low=0.0)
    rig.drive(0.5, 1.0)
    assert Judge(rig).tick()[0] > 0.0
    arrives(rig, (0.5, 1.0))


def test_from_straight_on_to_turning_on_the_spot_no_limit_is_exceeded():
    rig = base(axis(1.0, 0.5, 0.5, 5.0), axis(4.0, 8.0, 8.0), low=-10.0, high=10.0)
    rig.drive(1.0, 0.0)
    arrives(rig, (1.0, 0.0))
    rig.drive(0.0, 4.0)
    judge = Judge(rig)
    judge.run(4.0)
    assert judge.before == (0.0, 4.0)


# -------------------------------------------------------------------------------------- invariants
UP = st.sampled_from([0.2, 0.5, 1.0, 1.5, 3.0, 8.0])
JERK = st.sampled_from([math.inf, math.inf, 1.0, 5.0, 8.0, 40.0, 900.0])
AXIS = st.builds(axis, st.sampled_from([0.3, 1.0, 2.0]), UP, UP, JERK)
GOAL = st.tuples(
    st.floats(-2.5, 2.5) | st.sampled_from([0.0, 0.5, -0.5]),
    st.floats(-4.0, 4.0) | st.sampled_from([0.0, 1.0, -1.0]),
)
LOW = st.sampled_from([0.0, -2.0, -9.0])
HIGH = st.sampled_from([3.0, 9.0])
SEED = st.integers(0, 2**32)


def walk(judge: Judge, chance: Random) -> None:
    """Drive to random goals, near and far, some for a few ticks only; change the limits; stop now
    and then."""
    limits = judge.limits
    first = [tuple(getattr(a, name) for name in axis(0, 0, 0)) for a in limits]
    for _ in range(chance.randint(2, 7)):
        kind = chance.random()
        judge.rig.input.control.stop = kind < 0.15
        if kind > 0.8:
            share = chance.choice([0.1, 0.5, 0.9, 1.0])
            for i, name in enumerate(axis(0, 0, 0)):
                for of, was in zip(limits, first, strict=True):
                    setattr(of, name, was[i] * chance.choice([share, 1.0]))
        nearby = [v + chance.gauss(0.0, 0.05) for v in judge.before]
        judge.rig.drive(
            chance.choice([chance.uniform(-1.5, 1.5), nearby[0], 0.0]),
            chance.choice([chance.uniform(-3.0, 3.0), nearby[1], 0.0]),
        )
        for _ in range(chance.choice([1, 3, 20, 150, 400])):
            judge.tick()


@settings(max_examples=40)
@given(AXIS, AXIS, LOW, HIGH, SEED)
def test_no_limit_of_body_or_wheel_is_exceeded_for_any_goals(linear, angular, low, high, seed):
    walk(Judge(base(linear, angular, low, high)), Random(seed))


@settings(max_examples=20)
@given(AXIS, AXIS, LOW, HIGH, GOAL, SEED)
def test_a_goal_is_reached_from_any_state_of_the_base(linear, angular, low, high, goal, seed):
    judge = Judge(base(linear, angular, low, high))
    walk(judge, Random(seed))
    judge.rig.input.control.stop = 0
    judge.rig.drive(*goal)
    judge.tick()
    limits = judge.limits
    left = [abs(g - v) for g, v in zip(aim_of(judge.rig), judge.before, strict=True)]
    pairs = list(zip(left, limits, strict=True))
    gains = [min(a.acceleration_u_s2, a.deceleration_u_s2) for a in limits]
    slowest_s = max(away / gain for away, gain in zip(left, gains, strict=True))
    jerk_s2 = max(away / a.jerk_u_s3 for away, a in pairs)
    judge.run(slowest_s + 4.0 * math.sqrt(jerk_s2) + 0.01)
    assert judge.before == aim_of(judge.rig)


@settings(max_examples=20)
@given(AXIS, AXIS, LOW, HIGH, SEED)
def test_a_stop_from_any_state_keeps_its_curve_and_ends_in_time(linear, angular, low, high, seed):
    judge = Judge(base(linear, angular, low, high))
    walk(judge, Random(seed))
    judge.rig.input.control.stop = 1
    pairs = list(zip(judge.before, judge.limits, strict=True))
    slowest_s = max(abs(v) / a.deceleration_u_s2 for v, a in pairs)
    jerk_s2 = max(abs(v) / a.jerk_u_s3 for v, a in pairs)
    judge.rest(slowest_s + 2.0 * math.sqrt(jerk_s2) + 0.01)
    assert judge.rig.tick().at_rest


@settings(max_examples=20)
@given(AXIS, AXIS, LOW, HIGH, SEED)
def test_a_fault_ignores_the_jerk_limit_and_keeps_all_others(linear, angular, low, high, seed):
    judge = Judge(base(linear, angular, low, high))
    walk(judge, Random(seed))
    judge.rig.input.control.fault = 1
    pairs = list(zip(judge.before, judge.limits, strict=True))
    slowest_s = max(abs(v) / a.deceleration_u_s2 for v, a in pairs)
    ticks = judge.rest(slowest_s + 0.01, urgent=True)
    assert ticks == pytest.approx(slowest_s / TICK_S, abs=1.1)


@settings(max_examples=30)
@given(st.floats(0.05, 0.99), st.booleans(), AXIS, AXIS)
def test_every_curve_that_forward_wheels_can_roll_starts_at_once(share, left, linear, angular):
    rig = base(linear, angular | {"velocity_u_s": 2.0}, low=0.0)
    speed_m_s = 0.3
    turn_rad_s = share * speed_m_s / (TRACK_M / 2.0) * (1 if left else -1)
    rig.drive(speed_m_s, turn_rad_s)
    judge = Judge(rig)
    after = judge.tick()
    assert after[0] > 0.0
    assert after[1] * turn_rad_s > 0.0
    assert after[1] / after[0] == pytest.approx(turn_rad_s / speed_m_s)


def test_a_limit_lowered_in_a_curve_is_reached_by_braking_and_the_other_axis_keeps_its_own():
    rig = base(axis(1.0, 1.0, 1.5, 8.0), axis(2.0, 3.0, 4.0, 30.0))
    rig.drive(0.8, 1.0)
    arrives(rig, (0.8, 1.0))
    judge = Judge(rig)
    judge.tick()
    rig.input.control.limits.linear.velocity_u_s = 0.2
    seen = []
    while judge.before != (0.2, 1.0):
        seen.append(judge.tick())
        assert len(seen) < 3000
    assert all(now[0] <= last[0] for last, now in pairwise(seen))
    assert all(one[1] == 1.0 for one in seen)


def test_a_turn_that_oscillates_about_zero_does_not_delay_the_speed():
    rig = base(axis(1.0, 1.0, 1.0), axis(2.0, 3.0, 4.0))
    judge = Judge(rig)
    for n in range(22):
        rig.drive(1.0, 0.01 * (-1) ** n)
        judge.run(0.05)
    assert judge.before[0] == 1.0


@settings(max_examples=30)
@given(AXIS, AXIS, st.sampled_from([0.0, 0.1]), st.sampled_from([0.5, 2.0]), SEED)
def test_a_duty_slew_slows_the_whole_twist_and_bends_no_curve(linear, angular, band, slew, seed):
    rig = base(linear, angular, dead_band=band, slew_per_s=slew)
    judge, chance = Judge(rig), Random(seed)
    for _ in range(4):
        rig.drive(chance.uniform(-1.5, 1.5), chance.uniform(-3.0, 3.0))
        for _ in range(chance.choice([3, 150, 600])):
            last = [rig.out.joint[j].duty for j in range(2)]
            judge.tick()
            for j, before in enumerate(last):
                duty, speed = rig.out.joint[j].duty, rig.speeds[j]
                start = max(math.copysign(before, before * duty), band) if before else band
                assert abs(duty) <= start + slew * TICK_S * (1.0 + TINY)
                mapped = math.copysign(band, speed) + speed * (1.0 - band) / 15.0 if speed else 0.0
                assert duty == pytest.approx(mapped, abs=1e-12), "the duty is the twist's"
