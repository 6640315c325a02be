# SPDX-License-Identifier: Apache-2.0
"""Limits of joints without a base that change while they move: a lowered one is reached by
deceleration, and no joint leaves its range."""

import math
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rt.core_rig import TICK_S, core_config
from tests.rt.steered_oracle import ROLLS, PositionRig, steers

PAN, BELT = 0, 1
RANGE_RAD = 2.0
PAN_LIMITS = (3.0, 12.0, 12.0, math.inf)
ROUNDING_RAD = 1e-9
BELT_LIMITS = (8.0, 10.0, 16.0, math.inf)
NAMES = ("velocity_u_s", "acceleration_u_s2", "deceleration_u_s2", "jerk_u_s3")


class Joints(PositionRig):
    def __init__(self):
        pan = steers(RANGE_RAD, velocity_rad_s=3.0, acceleration_rad_s2=12.0)
        span = {"velocity_min_rad_s": -8.0, "velocity_max_rad_s": 8.0}
        belt = ROLLS | span | {"own": dict(zip(NAMES, BELT_LIMITS, strict=True))}
        super().__init__(core_config(2, joint=[pan, belt], joint_count=2, independent=1))
        self.arm()

    def ask(self, pan_rad, belt_rad_s):
        self.input.joints.named = 0b11
        self.input.joints.value_u[0:2] = [pan_rad, belt_rad_s]

    def limit(self, pan=PAN_LIMITS, belt=BELT_LIMITS):
        control = self.input.control
        control.joint_limits_count += 1
        control.joint_limits[PAN] = dict(zip(NAMES, pan, strict=True))
        control.joint_limits[BELT] = dict(zip(NAMES, belt, strict=True))

    def moves(self):
        """Angle and speed of one, speed of the other."""
        profile = self.state.steer.profile[PAN]
        return profile.position_rad, profile.velocity_rad_s, self.out.joint[BELT].velocity_rad_s


def test_a_lowered_speed_is_reached_by_deceleration():
    rig = Joints()
    rig.ask(1.9, 8.0)
    rig.ticks(0.4)
    before = rig.moves()
    assert before[1:] == pytest.approx((3.0, 4.0), abs=0.02)
    rig.ticks(0.1)
    rig.limit(pan=(1.0, 12.0, 12.0, math.inf), belt=(2.0, 10.0, 16.0, math.inf))
    last = rig.moves()
    for _ in range(250):
        rig.tick()
        now = rig.moves()
        assert last[1] - 12.0 * TICK_S * 1.001 <= now[1]
        assert last[2] - 16.0 * TICK_S * 1.001 <= now[2]
        last = now
    assert last[1:] == (1.0, 2.0)
    rig.limit()
    rig.ticks(0.8)
    assert rig.moves()[2] == 8.0


def test_a_limit_is_raised_no_farther_than_the_robot_files():
    rig = Joints()
    rig.limit(pan=(30.0, 12.0, 12.0, math.inf), belt=(80.0, 10.0, 16.0, math.inf))
    rig.ask(1.9, 50.0)
    fastest = [0.0, 0.0]
    for _ in range(1500):
        rig.tick()
        fastest = [max(old, abs(new)) for old, new in zip(fastest, rig.moves()[1:], strict=True)]
    assert fastest == [3.0, 8.0]


BAD = [
    (place, bad)
    for place in range(len(NAMES))
    for bad in (0.0, -1.0, math.nan, math.inf)
    if (NAMES[place], bad) != ("jerk_u_s3", math.inf)  # no limit
]


@pytest.mark.parametrize(("place", "bad"), BAD)
def test_where_one_is_out_of_range_all_stay_as_they_are(place, bad):
    rig = Joints()
    belt = list(BELT_LIMITS)
    belt[place] = bad
    rig.limit(pan=(0.1, 0.1, 0.1, math.inf), belt=tuple(belt))
    rig.ask(1.5, 4.0)
    rig.ticks(2.0)
    assert rig.moves() == (1.5, 0.0, 4.0)


def test_limits_changed_while_disarmed_hold_from_the_first_motion_on():
    rig = Joints()
    rig.ask(0.0, 0.0)
    rig.input.joints.named = 0
    rig.input.control.armed = 0
    rig.ticks(0.1)
    rig.limit(belt=(0.5, 10.0, 16.0, math.inf))
    rig.tick()
    rig.arm()
    rig.ask(0.0, 8.0)
    rig.ticks(1.0)
    assert rig.moves()[2] == 0.5


@pytest.mark.parametrize("target_rad", [0.2, 1.0, RANGE_RAD])
def test_an_acceleration_that_is_lowered_while_a_joint_brakes_lets_it_pass_nothing(target_rad):
    for wait in range(0, 900, 30):
        rig = Joints()
        rig.ask(target_rad, 0.0)
        for _ in range(wait):
            rig.tick()
        rig.limit(pan=(3.0, 0.5, 0.5, math.inf))
        last = rig.moves()[1]
        for _ in range(9000):
            rig.tick()
            position, speed, _ = rig.moves()
            assert position <= target_rad + ROUNDING_RAD
            assert abs(speed - last) <= 12.0 * TICK_S * 1.001
            last = speed
            if position == target_rad and speed == 0.0:
                break
        assert rig.moves()[:2] == (target_rad, 0.0)


@settings(max_examples=40)
@given(st.integers(0, 2**32))
def test_no_joint_leaves_its_range_or_steps_whatever_changes(seed):
    rig, chance = Joints(), Random(seed)
    highest = 12.0
    for _ in range(chance.randint(2, 8)):
        most = 12.0 * chance.choice([0.03, 0.2, 1.0])
        speed = 3.0 * chance.choice([0.1, 0.5, 1.0])
        rig.limit(pan=(speed, most, most, math.inf))
        rig.ask(chance.uniform(-3.0, 3.0), chance.uniform(-8.0, 8.0))
        if chance.random() < 0.3:
            rig.input.joints.named = 0
        rig.input.control.stop = chance.random() < 0.2
        for _ in range(chance.choice([1, 20, 300])):
            before = rig.moves()
            rig.tick()
            position, now, _ = rig.moves()
            assert abs(position) <= RANGE_RAD
            assert abs(now - before[1]) <= highest * TICK_S * (1 + 1e-6)
            assert position - before[0] == pytest.approx(now * TICK_S, abs=1e-5)
    rig.input.control.stop = 0
    rig.input.joints.named = 0
    rig.input.control.stop = 1
    rig.ticks(12.0)
    assert rig.moves()[1:] == (0.0, 0.0)
