# SPDX-License-Identifier: Apache-2.0
"""The view of `motord top`: the state, the advice on it, and the changes since the last answer."""

import math

import pytest

from motord.api.status import Status

pytest.importorskip("rich")

from motord.tui import view

JOINT = {
    "drive": "armed", "fault_words": [], "velocity_rad_s": 1.234, "setpoint_rad_s": 1.5,
    "current_a": 0.5, "temperature_c": 31.0, "feedback_age_s": 0.012, "stale": False,
}  # fmt: skip
LINE = {
    "state": "ready", "waits_for": None, "errors": {"timeout": 2, "bad_crc": 0},
    "cycle_hz": 48.2, "round_trip_us": {"p50": 4200.0, "p99": 5000.0, "max": 9100.0},
}  # fmt: skip
LEASE = {
    "owner": "motord-teleop", "priority": 10, "linear_m_s": 0.3, "angular_rad_s": 0.0,
    "rate_hz": 20.0, "held": False, "why": "the only one",
}  # fmt: skip


def answer(**changes):
    return Status.of(
        {
            "robot": "demo", "state": "moving", "rest": "turning", "why": [], "faults": [],
            "reasons": [],
            "odometry": {"linear_m_s": 0.3, "x_m": 1.0, "y_m": -0.001, "heading_rad": 0.1},
            "joints": {"left": JOINT, "right": JOINT}, "lines": {"rs485": LINE},
            "loop": {"rate_hz": 1000.0, "policy": "SCHED_FIFO", "overruns": 3,
                     "lateness_us": {"p50": 10.0, "p99": 40.0, "max": 200.0}},
            "leases": [LEASE], **changes,
        }
    )  # fmt: skip


def shown(found, history=None, now_s=0.0):
    history = history or view.History()
    history.add(found, now_s)
    parts = (
        view.header(found), view.joints(found, history), view.lines(found, history, now_s),
        view.leases(found),
    )  # fmt: skip
    return "\n".join(part.plain for part in parts)


@pytest.mark.parametrize("state", ["fault", "estop", "idle", "configuring", "stopping", "armed"])
def test_a_warning_comes_first_while_it_is_unknown_whether_a_wheel_turns(state):
    found = answer(state=state, rest="unknown", rest_unknown_s={"left": 3.2}, faults=["estop"])
    words = view.advice(found)
    assert words.text.startswith("motord cannot see whether left turns: keep away, cut the power")
    assert words.urgent
    assert not view.advice(answer(state="armed", rest="at_rest")).urgent


def test_a_moving_robot_is_shown_with_its_commander_and_its_limits():
    text = shown(answer(reasons=["linear_jerk", "not_armed"]))
    assert "MOVING" in text
    assert "motord-teleop commands; limited by linear_jerk" in text
    assert "y 0.00 m" in text  # and not -0.00


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"state": "fault", "why": ["left: over-current"]}, "left: over-current. Remove the cause"),
        ({"state": "estop", "faults": ["estop"]}, "estop. Remove the cause, then r resets."),
        ({"state": "idle"}, "a arms"),
        ({"state": "idle", "lines": {"a": {**LINE, "waits_for": "left does not answer"}}},
         "Cannot be armed yet: left does not answer"),
        ({"state": "armed", "leases": []}, "Any command moves the robot"),
        ({"state": "armed", "leases": [{**LEASE, "held": True}]}, "held until it sends zero"),
        ({"state": "configuring"}, "being configured"),
        ({"state": "stopping"}, "comes to rest"),
    ],
)  # fmt: skip
def test_each_state_comes_with_what_to_do_about_it(changes, words):
    assert words in shown(answer(**changes))


def test_all_lines_fit_into_80_columns():
    joints = {f"a-very-long-name-of-a-joint-{n}": JOINT for n in range(4)}
    text = shown(answer(joints=joints, state="armed", leases=[]))
    assert max(map(len, text.splitlines())) <= 80


def test_what_is_not_measured_is_a_dash():
    nothing = {**JOINT, "velocity_rad_s": None, "current_a": None, "feedback_age_s": None}
    row = view.joints(answer(joints={"left": nothing}), view.History()).plain.splitlines()[1]
    assert row.split()[2:7] == ["1.50", "–", "–", "31", "–"]


def test_a_trend_shows_direction_and_gaps():
    assert view.trend([0.0, 1.0, math.nan, 2.0], width=6) == "  ▁▅ █"
    assert view.trend([-1.0, 0.0], width=2) == "▁█"
    assert view.trend([], width=3) == "   "


def test_errors_that_grow_are_marked_for_a_while():
    history = view.History()
    history.add(answer(), 0.0)
    assert not history.grows("rs485", "timeout", 0.0)
    history.add(answer(lines={"rs485": {**LINE, "errors": {"timeout": 3}}}), 1.0)
    assert history.grows("rs485", "timeout", 1.5)
    assert not history.grows("rs485", "timeout", 1.0 + view.GREW_WITHIN_S)


def test_the_newest_records_of_the_log_are_shown():
    records = [{"time_s": 0.0, "level": "info", "text": f"record {n}"} for n in range(5)]
    assert "record 2" not in view.log_tail(records, 2).plain
    assert "record 4" in view.log_tail(records, 2).plain
    assert view.log_tail(records, 0).plain == ""


def test_an_answer_without_any_field_is_shown_too():
    assert "no source" in shown(Status.of({"state": "off"}))
