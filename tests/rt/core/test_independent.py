# SPDX-License-Identifier: Apache-2.0
"""Joints without a base, on the core: each by its own limits, in velocity or position, and every
stop ends at rest."""

import math

import pytest
from _motord_rt import ffi, lib
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rt.core_rig import TICK_S, assert_rest, core_config
from tests.rt.steered_oracle import ROLLS, PositionRig, steers

PAN, BELT, TILT = range(3)
RANGE_RAD = {PAN: 2.0, TILT: 0.8}
SPEED_RAD_S, SPEED_RAD_S2 = 3.0, 12.0
BELT_RAD_S, BELT_RAD_S2, BELT_DOWN_RAD_S2 = 8.0, 10.0, 16.0
STOPS = [lib.STOP_RAMP, lib.STOP_BRAKE, lib.STOP_HOLD, lib.STOP_COAST]


def places(range_rad, **position):
    return steers(
        range_rad, velocity_rad_s=SPEED_RAD_S, acceleration_rad_s2=SPEED_RAD_S2, **position
    )


def turns(jerk_u_s3=math.inf, **changes):
    limits = {"velocity_u_s": BELT_RAD_S, "jerk_u_s3": jerk_u_s3}
    limits |= {"acceleration_u_s2": BELT_RAD_S2, "deceleration_u_s2": BELT_DOWN_RAD_S2}
    span = {"velocity_min_rad_s": -BELT_RAD_S, "velocity_max_rad_s": BELT_RAD_S}
    return ROLLS | {"own": limits} | span | changes


def joints_config(*joints, **changes):
    joints = joints or (places(RANGE_RAD[PAN]), turns(), places(RANGE_RAD[TILT]))
    shape = {"joint_count": len(joints), "joint": list(joints), "independent": 1}
    return core_config(2, **(shape | changes))


class Joints(PositionRig):
    """A pan-tilt head with a conveyor between its joints."""

    def __init__(self, *joints, **changes):
        super().__init__(joints_config(*joints, **changes))

    def ask(self, **values):
        names = {"pan": PAN, "belt": BELT, "tilt": TILT}
        command = self.input.joints
        command.named = sum(1 << names[name] for name in values)
        for name, value in values.items():
            command.value_u[names[name]] = value

    def goals(self):
        return [self.state.steer.profile[j].position_rad for j in self.steering]

    def belt(self):
        return self.out.joint[BELT].velocity_rad_s


def test_each_joint_goes_where_or_as_fast_as_it_is_commanded():
    rig = Joints()
    rig.arm()
    rig.ask(pan=1.5, belt=-4.0, tilt=-0.5)
    rig.ticks(2.0)
    assert [rig.out.position_rad[j] for j in (PAN, TILT)] == [1.5, -0.5]
    assert rig.belt() == -4.0
    assert rig.out.positioned == 1 << PAN | 1 << TILT
    assert rig.shown.reasons == 0
    assert [rig.shown.joint[j].position_rad for j in (PAN, TILT)] == pytest.approx(
        [1.5, -0.5], abs=0.01
    )


def test_a_single_joint_needs_no_other():
    rig = Joints(places(1.0))
    rig.arm()
    rig.ask(pan=0.3)
    rig.ticks(1.0)
    assert rig.out.position_rad[PAN] == 0.3


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
    rig = Joints(places(RANGE_RAD[PAN]), turns(jerk_u_s3), places(RANGE_RAD[TILT]))
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
def test_no_joint_passes_what_it_was_commanded(first_rad, then_rad, belt_rad_s):
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
def test_every_stop_ends_at_rest_and_leaves_no_target_behind(
    end, action, ticks, pan_rad, belt_rad_s
):
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
    if end is not ask_nonsense:  # the lease goes on, and nothing else requests motion
        rig.ask()
    rig.hold.clear()
    rig.input.control.stop = rig.input.control.estop = rig.input.suspended = 0
    rig.ticks(0.5)
    assert rig.belt() == 0.0
    if rig.out.enabled:
        assert rig.goals() == held


def test_a_position_joint_that_a_command_leaves_out_goes_on_to_its_target():
    rig = Joints()
    rig.arm()
    rig.ask(pan=1.5)
    rig.ticks(0.1)
    rig.ask(belt=2.0)
    rig.ticks(2.0)
    assert rig.out.position_rad[PAN] == 1.5
    rig.ask(tilt=0.2)
    rig.ticks(2.0)
    assert rig.belt() == 0.0


def test_a_target_ends_with_the_lease_that_gave_it():
    rig = Joints()
    rig.input.control.owner = 4
    rig.arm()
    rig.ask(pan=1.5)
    rig.ticks(0.2)
    rig.input.control.owner = 5
    rig.ask(tilt=0.1)
    rig.ticks(1.0)
    held = rig.goals()[0]
    assert 0.0 < held < 1.0
    rig.ticks(0.5)
    assert rig.goals() == [held, 0.1]


def test_a_position_beyond_the_range_becomes_its_end_and_a_reason():
    rig = Joints()
    rig.arm()
    rig.ask(tilt=5.0, belt=20.0)
    rig.ticks(2.0)
    assert rig.out.position_rad[TILT] == RANGE_RAD[TILT]
    assert rig.belt() == BELT_RAD_S
    assert rig.shown.reasons == lib.REASON_JOINT_POSITION | lib.REASON_JOINT_VELOCITY


def test_where_a_joint_is_not_known_nothing_arms_and_nothing_moves():
    rig = Joints(places(2.0, reference=lib.REFERENCE_HOMED), turns())
    for feedback in rig.feedback:
        feedback.referenced = 0
    rig.tick()
    rig.input.control.armed = 1
    rig.tick()
    rig.input.control.armed = 0
    rig.tick()
    assert rig.shown.reasons & lib.REASON_POSITION_UNKNOWN
    rig.input.control.armed = 1
    rig.tick()
    assert (rig.shown.armed, rig.out.enabled, rig.out.positioned) == (0, 0, 0)
    rig.feedback[0].referenced = 1
    rig.input.control.armed = 0
    rig.tick()
    rig.arm()
    rig.ask(pan=1.0, belt=3.0)
    rig.ticks(0.1)
    assert rig.belt() > 0.0
    rig.feedback[0].referenced = 0
    rig.tick()
    assert rig.shown.faults == lib.FAULT_POSITION_UNKNOWN
    assert rig.out.positioned == 0
    rig.ticks(1.0)
    assert rig.belt() == 0.0


def test_what_measures_nothing_gets_the_time_of_its_longest_move_before_it_counts_as_anywhere():
    blind = places(1.5, reference=lib.REFERENCE_ESTIMATED) | {"counter_bits": 0}
    rig = Joints(blind, turns())
    rig.arm()
    rig.ask(pan=1.0)
    rig.ticks(0.9)
    assert rig.out.position_rad[PAN] == 0.0
    rig.ticks(2.0)
    assert rig.out.position_rad[PAN] == 1.0
    assert rig.shown.joint[PAN].position_rad == 1.0


def test_a_twist_moves_no_joint():
    rig = Joints()
    rig.arm()
    rig.drive(0.5, 1.0)
    rig.ticks(0.5)
    assert_rest(rig)
    assert rig.goals() == [0.0, 0.0]


def test_arming_needs_a_command_of_zero():
    rig = Joints()
    rig.ask(pan=0.0)
    rig.tick()
    rig.input.control.armed = 1
    assert rig.tick().armed == 0
    rig.ask()
    rig.input.control.armed = 0
    rig.tick()
    rig.arm()


def test_odometry_of_no_base_stays_at_the_origin():
    rig = Joints()
    rig.arm()
    rig.ask(belt=5.0)
    shown = rig.ticks(1.0)
    assert (shown.x_m, shown.y_m, shown.heading_rad, shown.distance_m) == (0.0, 0.0, 0.0, 0.0)
    assert shown.joint[BELT].position_rad > 2.0
    assert shown.odometry_degraded == 0


REFUSED = {
    "independent": {"independent": 2},
    "joint_count": {"joint_count": 0},
    "joint[1].own.acceleration_u_s2": {"joint": [places(1.0), ROLLS], "joint_count": 2},
    "gyro.used": {"gyro": {"used": 1}},
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_configuration_that_cannot_work_is_refused_by_name(name):
    config = ffi.new("core_config *", joints_config() | REFUSED[name])
    found = ffi.new("char[]", lib.FIELD_NAME_BYTES)
    assert ffi.string(lib.core_config_check(config, found)).decode() == name
