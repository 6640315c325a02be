# SPDX-License-Identifier: Apache-2.0
"""Joints without a base, on the core: each keeps its own limits of velocity or position, also while
these change, and every stop ends at rest."""

import math
from random import Random

import pytest
from _motord_rt import lib
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rt.core_rig import TICK_S, core_config
from tests.rt.steered_oracle import ROLLS, PositionRig, steers

PAN, BELT, TILT = range(3)
RANGE_RAD = {PAN: 2.0, TILT: 0.8}
SPEED_RAD_S, SPEED_RAD_S2 = 3.0, 12.0
BELT_RAD_S, BELT_RAD_S2, BELT_DOWN_RAD_S2 = 8.0, 10.0, 16.0
STOPS = [lib.STOP_RAMP, lib.STOP_BRAKE, lib.STOP_HOLD, lib.STOP_COAST]


def places(range_rad):
    return steers(range_rad, velocity_rad_s=SPEED_RAD_S, acceleration_rad_s2=SPEED_RAD_S2)


def turns(jerk_u_s3):
    limits = {"velocity_u_s": BELT_RAD_S, "jerk_u_s3": jerk_u_s3}
    limits |= {"acceleration_u_s2": BELT_RAD_S2, "deceleration_u_s2": BELT_DOWN_RAD_S2}
    span = {"velocity_min_rad_s": -BELT_RAD_S, "velocity_max_rad_s": BELT_RAD_S}
    return ROLLS | {"own": limits} | span


class Joints(PositionRig):
    """A pan-tilt head with a conveyor between its joints."""

    def __init__(self, jerk_u_s3=math.inf, **changes):
        joints = [places(RANGE_RAD[PAN]), turns(jerk_u_s3), places(RANGE_RAD[TILT])]
        super().__init__(core_config(2, joint_count=3, joint=joints, independent=1, **changes))

    def ask(self, **values):
        names = {"pan": PAN, "belt": BELT, "tilt": TILT}
        command = self.input.joints
        command.named = sum(1 << names[name] for name in values)
        for name, value in values.items():
            command.value_u[names[name]] = value

    def limit_pan(self, velocity_rad_s, acceleration_rad_s2):
        control = self.input.control
        control.joint_limits_count += 1
        for j in range(3):
            control.joint_limits[j] = self.state.joint_limits[j]
        pan = control.joint_limits[PAN]
        pan.velocity_u_s = velocity_rad_s
        pan.acceleration_u_s2 = pan.deceleration_u_s2 = acceleration_rad_s2

    def goals(self):
        return [self.state.steer.profile[j].position_rad for j in self.steering]

    def belt(self):
        return self.out.joint[BELT].velocity_rad_s


COMMAND = st.fixed_dictionaries(
    {},
    optional={
        "pan": st.floats(-30.0, 30.0),
        "belt": st.floats(-90.0, 90.0),
        "tilt": st.floats(-1.0, 1.0),
    },
)


@settings(max_examples=40)
@given(
    st.lists(st.tuples(COMMAND, st.integers(1, 400)), min_size=1, max_size=5),
    st.sampled_from([math.inf, 60.0]),
)
def test_the_limits_hold_in_every_tick(commands, jerk_u_s3):
    rig = Joints(jerk_u_s3)
    rig.arm()
    before, speed, belt = rig.goals(), [0.0, 0.0], 0.0
    for values, ticks in commands:
        rig.ask(**values)
        for _ in range(ticks):
            rig.tick()
            for k, j in enumerate((PAN, TILT)):
                now = rig.out.position_rad[j]
                rate = (now - before[k]) / TICK_S
                assert abs(now) <= RANGE_RAD[j]
                assert abs(rate) <= SPEED_RAD_S * (1 + 1e-9)
                assert abs(rate - speed[k]) <= SPEED_RAD_S2 * TICK_S * (1 + 1e-6) + 1e-9
                before[k], speed[k] = now, rate
            slower = abs(rig.belt()) < abs(belt) or rig.belt() * belt < 0.0
            most = BELT_DOWN_RAD_S2 if slower else BELT_RAD_S2
            assert abs(rig.belt()) <= BELT_RAD_S
            assert abs(rig.belt() - belt) <= most * TICK_S * (1 + 1e-9)
            belt = rig.belt()


@settings(max_examples=40)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-8.0, 8.0))
def test_no_joint_passes_its_commanded_goal(first_rad, then_rad, belt_rad_s):
    rig = Joints()
    rig.arm()
    for goal_rad in (first_rad, then_rad):
        rig.ask(pan=goal_rad, belt=belt_rad_s)
        start_rad = rig.goals()[0]
        low, high = sorted((start_rad, goal_rad))
        for _ in range(2500):
            rig.tick()
            assert low <= rig.out.position_rad[PAN] <= high
            assert 0.0 <= math.copysign(1.0, belt_rad_s) * rig.belt() <= abs(belt_rad_s)
        assert rig.out.position_rad[PAN] == goal_rad
    assert rig.belt() == belt_rad_s


def lapse(rig):
    rig.hold.add("command")


def stop(rig):
    rig.input.control.stop = 1


def disarm(rig):
    rig.input.control.armed = 0


def estop(rig):
    rig.input.control.estop = 1


def lose_feedback(rig):
    rig.hold.add("feedback")


def suspend(rig):
    rig.input.suspended = 1


def ask_nonsense(rig):
    rig.ask(pan=math.nan, belt=math.inf)


ENDS = [lapse, stop, disarm, estop, lose_feedback, suspend, ask_nonsense]


@pytest.mark.parametrize("action", STOPS)
@pytest.mark.parametrize("end", ENDS)
@settings(max_examples=6)
@given(st.integers(1, 600), st.floats(-2.0, 2.0), st.floats(-8.0, 8.0))
def test_every_stop_ends_at_rest_and_leaves_no_target(end, action, ticks, pan_rad, belt_rad_s):
    rig = Joints(on_timeout=action, on_fault=action, on_estop=action)
    rig.arm()
    rig.ask(pan=pan_rad, belt=belt_rad_s, tilt=0.4)
    for _ in range(ticks):
        rig.tick()
    end(rig)
    rig.ticks(2.0)
    assert [rig.shown.joint[j].setpoint_rad_s for j in range(3)] == [0.0] * 3
    assert rig.belt() == 0.0
    held = rig.goals()
    if end is not ask_nonsense:  # the lease continues, and nothing else requests motion
        rig.ask()
    rig.hold.clear()
    rig.input.control.stop = rig.input.control.estop = rig.input.suspended = 0
    rig.ticks(0.5)
    assert rig.belt() == 0.0
    if rig.out.enabled:
        assert rig.goals() == held


@settings(max_examples=40)
@given(st.integers(0, 2**32))
def test_no_joint_leaves_its_range_or_steps_for_any_change(seed):
    rig, chance = Joints(), Random(seed)
    rig.arm()
    before, speed = 0.0, 0.0
    for _ in range(chance.randint(2, 8)):
        rig.limit_pan(
            SPEED_RAD_S * chance.choice([0.1, 0.5, 1.0]),
            SPEED_RAD_S2 * chance.choice([0.03, 0.2, 1.0]),
        )
        if chance.random() < 0.3:
            rig.ask()
        else:
            rig.ask(pan=chance.uniform(-3.0, 3.0), belt=chance.uniform(-8.0, 8.0))
        rig.input.control.stop = chance.random() < 0.2
        for _ in range(chance.choice([1, 20, 300])):
            rig.tick()
            profile = rig.state.steer.profile[PAN]
            now, rate = profile.position_rad, profile.velocity_rad_s
            assert abs(now) <= RANGE_RAD[PAN]
            assert abs(rate - speed) <= SPEED_RAD_S2 * TICK_S * (1 + 1e-6)
            assert now - before == pytest.approx(rate * TICK_S, abs=1e-5)
            before, speed = now, rate
    rig.ask()
    rig.input.control.stop = 1
    rig.ticks(12.0)
    assert (rig.state.steer.profile[PAN].velocity_rad_s, rig.belt()) == (0.0, 0.0)
