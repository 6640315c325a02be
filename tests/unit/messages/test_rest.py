# SPDX-License-Identifier: Apache-2.0
"""Whether the robot rests, in words and in what the buses publish: at rest, turning or unknown."""

import pytest
from tests.unit.messages.bus_views import BODY, MS, view
from tests.unit.messages.bus_views import message as message_of

from motord.api.snapshot import Rest, rest_report, rest_text, rest_word, stop_answer
from motord.bus.messages.sources import Level
from motord.bus.prometheus.metrics import exposition

WARNING = "motord cannot see whether {}: keep away, cut the power"
LEFT_SINCE = (250 * MS, *(0,) * 7)


def seen(rest, since_ns=(0,) * 8, unmeasured=0):
    return view(1000, rest=rest, rest_unknown_since_ns=since_ns, rest_unmeasured=unmeasured)


def test_the_joints_that_are_unknown_are_named_and_since_when():
    report = rest_report(seen("unknown", LEFT_SINCE).snapshot, ("left", "right"))
    assert report == {"rest": "unknown", "rest_unknown_s": {"left": 0.75}, "rest_unmeasured": []}
    report = rest_report(seen("at_rest", unmeasured=0b10).snapshot, ("left", "right"))
    assert report == {"rest": "at_rest", "rest_unknown_s": {}, "rest_unmeasured": ["right"]}


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ((), "a wheel turns"),
        (("left",), "left turns"),
        (("left", "right"), "left and right turn"),
        (("a", "b", "c"), "a, b and c turn"),
    ],
)
def test_unknown_is_a_warning_in_words(joints, words):
    assert rest_text("unknown", joints) == WARNING.format(words)


def test_rest_that_was_seen_needs_no_words_and_one_that_was_not_measured_has_some():
    assert rest_text("at_rest", ()) == rest_text("turning", ("left",)) == ""
    assert "nothing measures whether left" in rest_text("at_rest", (), ["left"])


def test_a_number_that_is_not_known_is_no_rest():
    assert [rest_word(number) for number in range(4)] == [*Rest, Rest.UNKNOWN]


@pytest.mark.parametrize("method", ["stop", "disarm", "estop"])
def test_a_stop_is_no_success_while_rest_is_unknown_but_an_emergency_stop_is_latched(method):
    answer = {"state": "fault", "rest": "unknown", "rest_unknown_s": {"left": 1.0}}
    success, text = stop_answer(method, answer)
    assert (success, WARNING.format("left turns") in text) == (method == "estop", True)
    assert stop_answer(method, answer | {"rest": "at_rest"}) == (True, "fault")
    assert stop_answer(method, {"state": "armed"}) == (True, "armed")


@pytest.mark.parametrize("rest", list(Rest))
def test_motor_status_has_the_three_values_and_the_joints(rest):
    since_ns = LEFT_SINCE if rest == "unknown" else (0,) * 8
    found = message_of("motor_status", seen(rest, since_ns, unmeasured=0b10), BODY, 0)
    assert (found.rest, list(found.rest_unmeasured)) == (rest, [BODY.joints[1]])
    unknown = ([BODY.joints[0]], [0.75]) if rest == "unknown" else ([], [])
    assert (list(found.rest_unknown), list(found.rest_unknown_s)) == unknown


def test_diagnostics_warn_in_words():
    base, *_ = message_of("diagnostics", seen("unknown", LEFT_SINCE), BODY, 0).status
    assert base.level == Level.ERROR
    assert WARNING.format(f"{BODY.joints[0]} turns") in base.message
    base, *_ = message_of("diagnostics", seen("at_rest"), BODY, 0).status
    assert base.level == Level.OK


def test_prometheus_has_the_three_values_and_how_long_a_joint_has_been_unknown(monkeypatch):
    monkeypatch.setattr("time.monotonic_ns", lambda: 1000 * MS)
    text = exposition(BODY, seen("unknown", LEFT_SINCE)).decode()
    assert f'motord_rest{{rest="unknown",robot="{BODY.robot}"}} 1.0' in text
    assert f'motord_rest{{rest="at_rest",robot="{BODY.robot}"}} 0.0' in text
    row = f'motord_joint_rest_unknown_seconds{{joint="{BODY.joints[0]}",robot="{BODY.robot}"}} 0.75'
    assert row in text
