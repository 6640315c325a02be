# SPDX-License-Identifier: Apache-2.0
"""core_step: faults, their stop actions, and the way back."""

import math

import pytest
from _motord_rt import lib
from tests.rt.core_rig import TICK_NS, Rig, assert_rest, core_config

NOT_NUMBERS = [math.nan, math.inf, -math.inf]
BAD_STEPS = [*NOT_NUMBERS, 0.0, -0.0, -0.001, -1e300]


def estop_level(rig: Rig) -> None:
    rig.input.control.estop = 1


def external_fault(rig: Rig) -> None:
    rig.input.control.fault = 1


def lose_heartbeat(rig: Rig) -> None:
    rig.hold.add("heartbeat")


def lose_feedback(rig: Rig) -> None:
    rig.hold.add("feedback")


def report_drive_fault(rig: Rig) -> None:
    rig.feedback[0].drive_faults = 1


def report_disabled(rig: Rig) -> None:
    rig.feedback[0].enabled = 0


CAUSES = {
    "FAULT_ESTOP": estop_level,
    "FAULT_EXTERNAL": external_fault,
    "FAULT_HEARTBEAT_LOST": lose_heartbeat,
    "FAULT_FEEDBACK_STALE": lose_feedback,
    "FAULT_DRIVE": report_drive_fault,
    "FAULT_DRIVE_DISABLED": report_disabled,
}


def undo(rig: Rig) -> None:
    rig.hold.clear()
    rig.input.control.estop = rig.input.control.fault = 0
    rig.feedback[0].drive_faults = 0
    rig.feedback[0].enabled = 1


@pytest.mark.parametrize("name", CAUSES)
def test_a_fault_is_latched_ends_at_rest_and_goes_only_by_a_reset(name):
    rig = Rig()
    rig.moving()
    CAUSES[name](rig)
    rig.ticks(0.6)
    assert rig.shown.faults == getattr(lib, name)
    assert rig.shown.armed == 0
    assert rig.shown.reasons & lib.REASON_FAULT
    rig.ticks(2.5)
    assert_rest(rig, enabled=0)
    undo(rig)
    rig.drive(0.0)
    rig.ticks(0.1)
    assert rig.shown.faults == getattr(lib, name)
    rig.reset()
    assert rig.shown.faults == 0
    rig.ticks(0.1)
    assert rig.shown.armed == 0, "a reset never arms"
    assert_rest(rig, enabled=0)


@pytest.mark.parametrize(
    "name", ["FAULT_ESTOP", "FAULT_EXTERNAL", "FAULT_FEEDBACK_STALE", "FAULT_DRIVE"]
)
def test_a_reset_while_the_cause_is_there_is_refused_and_not_remembered(name):
    rig = Rig()
    rig.moving()
    CAUSES[name](rig)
    rig.ticks(3.0)
    rig.drive(0.0)
    rig.tick()
    rig.reset()
    assert rig.shown.faults == getattr(lib, name)
    undo(rig)
    rig.ticks(0.1)
    assert rig.shown.faults == getattr(lib, name)


def test_a_reset_while_something_commands_motion_is_refused():
    rig = Rig()
    rig.moving()
    estop_level(rig)
    rig.ticks(1.0)
    undo(rig)
    rig.reset()
    assert rig.shown.faults == lib.FAULT_ESTOP


def test_a_reset_while_a_wheel_turns_is_refused():
    rig = Rig()
    rig.moving()
    estop_level(rig)
    rig.ticks(1.0)
    undo(rig)
    rig.drive(0.0)
    rig.hold.add("feedback")
    for feedback in rig.feedback:
        feedback.velocity_rad_s = 1.0
        feedback.stamp_ns = rig.input.now_ns + TICK_NS
    rig.tick()
    assert rig.shown.at_rest == 0
    rig.reset()
    assert rig.shown.faults == lib.FAULT_ESTOP


def test_faults_of_an_unarmed_base_are_not_latched_but_those_of_the_house_are():
    rig = Rig()
    rig.tick()
    lose_heartbeat(rig)
    lose_feedback(rig)
    report_drive_fault(rig)
    report_disabled(rig)
    assert rig.ticks(1.0).faults == 0
    external_fault(rig)
    estop_level(rig)
    assert rig.tick().faults == lib.FAULT_ESTOP | lib.FAULT_EXTERNAL
    assert_rest(rig, enabled=0)


def test_a_drive_that_was_off_before_arming_may_report_so_until_it_is_received_again():
    rig = Rig()
    rig.hold.add("feedback")
    rig.tick()
    for feedback in rig.feedback:
        feedback.enabled = 0
        feedback.stamp_ns = rig.input.now_ns
    rig.input.control.armed = 1
    assert rig.tick().armed == 1
    assert rig.ticks(0.02).faults == 0
    rig.feedback[0].stamp_ns = rig.input.now_ns
    assert rig.tick().faults == lib.FAULT_DRIVE_DISABLED


def test_a_drive_that_cannot_report_whether_it_is_enabled_is_no_fault():
    rig = Rig()
    for feedback in rig.feedback:
        feedback.enabled = 2
    rig.moving()
    assert rig.shown.faults == 0


def test_in_a_fault_the_ramp_brakes_with_all_its_deceleration_and_power_stays_on():
    rig = Rig()
    rig.moving(0.5)
    external_fault(rig)
    rig.tick()
    assert rig.shown.setpoint_linear_m_s == pytest.approx(0.5 - 1.5 * 0.001)
    ticks = 1
    while rig.shown.at_rest == 0:
        assert rig.out.enabled == 1
        rig.tick()
        ticks += 1
    assert ticks == pytest.approx(334, abs=3)
    rig.tick()
    assert rig.out.enabled == 0


def test_a_fault_that_brakes_sets_zero_at_once_and_keeps_power_until_rest():
    rig = Rig(core_config(on_fault=lib.STOP_BRAKE))
    rig.moving(0.5)
    external_fault(rig)
    rig.tick()
    assert_rest(rig, enabled=1)
    rig.ticks(0.003)
    assert_rest(rig, enabled=0)


def test_a_fault_that_coasts_takes_the_power_off_at_once():
    rig = Rig(core_config(on_fault=lib.STOP_COAST))
    rig.moving(0.5)
    external_fault(rig)
    rig.tick()
    assert_rest(rig, enabled=0)


def test_a_fault_that_holds_keeps_the_drives_at_zero_until_the_reset():
    rig = Rig(core_config(on_fault=lib.STOP_HOLD))
    rig.moving(0.5)
    external_fault(rig)
    rig.ticks(5.0)
    assert_rest(rig, enabled=1)
    rig.input.control.armed = 0
    rig.ticks(1.0)
    assert_rest(rig, enabled=1)
    undo(rig)
    rig.drive(0.0)
    rig.tick()
    rig.reset()
    assert_rest(rig, enabled=0)


def test_power_goes_off_two_seconds_after_zero_also_when_a_wheel_is_not_seen_to_rest():
    rig = Rig()
    rig.moving(0.5)
    lose_feedback(rig)
    rig.ticks(0.251)
    assert rig.shown.faults == lib.FAULT_FEEDBACK_STALE
    rig.ticks(0.4)
    assert_rest(rig, enabled=1)
    rig.ticks(1.9)
    assert rig.out.enabled == 1
    rig.ticks(0.2)
    assert rig.out.enabled == 0


@pytest.mark.parametrize("action", ["STOP_RAMP", "STOP_BRAKE", "STOP_HOLD", "STOP_COAST"])
def test_the_estop_replaces_an_action_that_goes_on(action):
    rig = Rig(core_config(on_fault=lib.STOP_RAMP, on_estop=getattr(lib, action)))
    rig.moving(0.5)
    external_fault(rig)
    rig.ticks(0.01)
    before = rig.speeds[0]
    estop_level(rig)
    rig.tick()
    ramps = action in ("STOP_RAMP", "STOP_HOLD")
    assert (0.0 < rig.speeds[0] < before) if ramps else rig.speeds == [0.0, 0.0]
    assert rig.out.enabled == (action != "STOP_COAST")
    rig.ticks(3.0)
    assert_rest(rig, enabled=int(action == "STOP_HOLD"))


def test_a_later_fault_does_not_replace_the_estops_action():
    rig = Rig(core_config(on_fault=lib.STOP_COAST, on_estop=lib.STOP_HOLD))
    rig.moving(0.5)
    estop_level(rig)
    rig.ticks(0.01)
    external_fault(rig)
    rig.ticks(1.0)
    assert_rest(rig, enabled=1)


@pytest.mark.parametrize("dt", BAD_STEPS)
def test_a_time_step_that_is_none_is_zero_at_once_and_latched(dt):
    rig = Rig()
    rig.moving(0.5)
    rig.tick(dt)
    assert_rest(rig)
    assert rig.shown.faults == lib.FAULT_TIME_STEP
    assert rig.shown.dt_s == 0.0
    rig.ticks(0.1)
    assert_rest(rig, enabled=0)


def test_after_a_pause_the_ramp_goes_on_as_after_a_tenth_of_a_second():
    rig = Rig()
    rig.moving(0.5)
    external_fault(rig)
    rig.tick(1e300)
    assert rig.shown.setpoint_linear_m_s == pytest.approx(0.5 - 1.5 * 0.1)


@pytest.mark.parametrize("broken", NOT_NUMBERS)
@pytest.mark.parametrize("place", ["linear", "angular", "duty", "x_m", "position_rad"])
@pytest.mark.parametrize("armed", [True, False])
def test_a_number_inside_that_is_none_is_rest_and_a_fault(place, broken, armed):
    rig = Rig()
    if armed:
        rig.moving(0.5)
    else:
        rig.tick()
    state = rig.state
    if place in ("linear", "angular"):
        state.axis[lib.AXIS_LINEAR if place == "linear" else lib.AXIS_ANGULAR].velocity_u_s = broken
    elif place == "duty":
        state.wheels.joint[1].duty = broken
    elif place == "x_m":
        state.odometry.x_m = broken
    else:
        state.odometry.joint[0].position_rad = broken
    rig.tick()
    assert rig.shown.faults == lib.FAULT_STATE
    assert_rest(rig)
    assert math.isfinite(rig.shown.x_m)
    assert math.isfinite(rig.shown.joint[0].position_rad)
    rig.ticks(0.1)
    assert_rest(rig, enabled=0)
