# SPDX-License-Identifier: Apache-2.0
"""The state machine: every pair of state and event, and every path through them."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.api.snapshot import Rest
from motord.control.machine import TABLE, Event, Facts, Refusal, State, step

GOOD = Facts()
BAD = {
    "line": replace(GOOD, unready_lines=("rs485",)),
    "feedback": replace(GOOD, stale_joints=("left",)),
    "command": replace(GOOD, commanding="joystick"),
}
LATCHED = (State.FAULT, State.ESTOP)
PAIRS = [(state, event) for state in State for event in Event]

facts = st.builds(
    Facts,
    unready_lines=st.sampled_from([(), ("rs485",)]),
    stale_joints=st.sampled_from([(), ("left", "right")]),
    drive_faults=st.sampled_from([(), ("left: over-current",)]),
    commanding=st.sampled_from([None, "joystick"]),
    rest=st.sampled_from(Rest),
)


@pytest.mark.parametrize(("state", "event"), PAIRS)
def test_every_event_is_decided_in_every_state(state, event):
    assert isinstance(step(state, event, GOOD), State | Refusal)
    assert set(TABLE) == set(PAIRS)


@pytest.mark.parametrize("state", State)
def test_the_emergency_stop_outranks_everything(state):
    for about in (GOOD, *BAD.values()):
        assert step(state, Event.ESTOP, about) is State.ESTOP


@pytest.mark.parametrize("state", State)
def test_the_daemon_can_end_from_every_state(state):
    assert step(state, Event.SHUTDOWN, GOOD) is State.OFF


@pytest.mark.parametrize("state", State)
def test_a_fault_is_latched_from_every_state_and_hides_no_emergency_stop(state):
    expected = State.ESTOP if state is State.ESTOP else State.FAULT
    assert step(state, Event.FAULT, GOOD) is expected


@pytest.mark.parametrize("state", LATCHED)
def test_only_reset_and_shutdown_lead_out_of_a_latched_state(state):
    out = {event for event in Event if step(state, event, GOOD) not in LATCHED}
    refused = {event for event in out if isinstance(step(state, event, GOOD), Refusal)}
    assert out - refused == {Event.RESET, Event.SHUTDOWN}


def test_only_arm_leads_from_rest_without_power_to_power():
    dead = [state for state in State if not state.live]
    paths = {
        (state, event)
        for state in dead
        for event in Event
        if isinstance(target := TABLE[state, event], State) and target.live
    }
    assert paths == {(State.IDLE, Event.ARM)}


@given(events=st.lists(st.tuples(st.sampled_from(Event), facts), max_size=40))
def test_no_path_leads_from_a_latched_state_to_power_without_reset_and_then_arm(events):
    state, latched, reset = State.OFF, False, False
    for event, about in events:
        before = state
        target = step(state, event, about)
        state = state if isinstance(target, Refusal) else target
        if state in LATCHED:
            latched, reset = True, False
        elif before in LATCHED and event in (Event.RESET, Event.SHUTDOWN):
            reset = True
        if state.live and not before.live:
            assert event is Event.ARM
            assert not latched or reset


@given(state=st.sampled_from(State), about=facts)
def test_arming_needs_ready_lines_fresh_feedback_no_drive_fault_and_nothing_driving(state, about):
    target = step(state, Event.ARM, about)
    if target is State.ARMED and state is State.IDLE:
        assert not about.unready_lines
        assert not about.stale_joints
        assert not about.drive_faults
        assert about.commanding is None


@given(state=st.sampled_from(LATCHED), about=facts)
def test_reset_needs_the_cause_gone_rest_and_nothing_driving(state, about):
    if step(state, Event.RESET, about) is State.IDLE:
        assert about.rest is not Rest.TURNING
        assert not about.unready_lines
        assert not about.stale_joints
        assert about.commanding is None


@pytest.mark.parametrize(("what", "named"), [("line", "rs485"), ("feedback", "left"),
                                             ("command", "joystick")])  # fmt: skip
def test_a_refusal_names_what_causes_it(what, named):
    for state, event in ((State.IDLE, Event.ARM), (State.FAULT, Event.RESET)):
        refusal = step(state, event, BAD[what])
        assert isinstance(refusal, Refusal)
        assert named in refusal.reason


def test_a_drive_fault_hinders_arming_and_not_its_own_reset():
    about = replace(GOOD, drive_faults=("left: over-current",))
    refusal = step(State.IDLE, Event.ARM, about)
    assert isinstance(refusal, Refusal)
    assert "left: over-current" in refusal.reason
    assert step(State.FAULT, Event.RESET, about) is State.IDLE


def test_arming_what_is_armed_changes_nothing():
    assert step(State.ARMED, Event.ARM, BAD["command"]) is State.ARMED
    assert step(State.MOVING, Event.ARM, BAD["command"]) is State.MOVING


def test_a_typical_day():
    state = State.OFF
    for event, expected in [
        (Event.START, State.CONFIGURING),
        (Event.READY, State.IDLE),
        (Event.ARM, State.ARMED),
        (Event.MOVED, State.MOVING),
        (Event.RESTED, State.ARMED),
        (Event.MOVED, State.MOVING),
        (Event.STOP, State.STOPPING),
        (Event.MOVED, State.STOPPING),
        (Event.STOPPED, State.ARMED),
        (Event.DISARM, State.STOPPING),
        (Event.DISARMED, State.IDLE),
        (Event.LOST, State.CONFIGURING),
        (Event.READY, State.IDLE),
        (Event.SHUTDOWN, State.OFF),
    ]:
        target = step(state, event, GOOD)
        assert target is expected
        state = target


def test_the_numbers_of_the_state_page_stay_what_they_are():
    assert {state.value: state.number for state in State} == {
        "off": 0, "configuring": 1, "idle": 2, "armed": 3,
        "moving": 4, "stopping": 5, "fault": 6, "estop": 7,
    }  # fmt: skip


def test_the_emergency_stops_contact_forbids_the_reset_and_reports_why():
    why = "the emergency stop's contact (GPIO17 of pinctrl-rp1) is active"
    refusal = step(State.ESTOP, Event.RESET, Facts(estop_input=why))
    assert isinstance(refusal, Refusal)
    assert refusal.reason == why
    assert step(State.ESTOP, Event.RESET, Facts()) is State.IDLE


def test_a_joint_whose_place_is_unknown_keeps_the_robot_from_arming_and_is_named():
    refusal = step(State.IDLE, Event.ARM, Facts(lost_positions=("steering",)))
    assert refusal == Refusal("where steering stands is not known; home it, then try again")
