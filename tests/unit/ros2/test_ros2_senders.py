# SPDX-License-Identifier: Apache-2.0
"""Senders on one topic: their names, and whether they command against each other."""

from types import SimpleNamespace

import pytest

from motord.bus.ros2.senders import REPORTED_S, SENDERS_MAX, Contest, Graph

GO, TURN, REST = (0.3, 0.0), (0.0, 0.5), (0.0, 0.0)


def contest():
    return Contest("input.ros2: cmd_vel", 0.5)


def alternate(made, first, second, count=20, start_s=0.0):
    """Receive commands of /nav at 20 Hz and of /teleop at 10 Hz; return the time after the last."""
    for number in range(count):
        made.received("/nav", first, start_s + 0.05 * number)
        if number % 2:
            made.received("/teleop", second, start_s + 0.05 * number + 0.01)
    return start_s + 0.05 * count


def test_two_senders_of_different_commands_are_named_with_their_rates(caplog):
    made = contest()
    now_s = alternate(made, GO, REST)
    found = {row["from"]: row["rate_hz"] for row in made.report(now_s)}
    assert found == {"/nav": pytest.approx(20.0, rel=0.1), "/teleop": pytest.approx(10.0, rel=0.1)}
    alternate(made, GO, REST, start_s=now_s)
    assert caplog.text.count("command against each other") == 1
    assert "/nav (20 Hz) and /teleop (10 Hz)" in caplog.text


def test_two_senders_of_the_same_command_are_no_contest(caplog):
    made = contest()
    assert made.report(alternate(made, GO, GO)) == []
    assert "against" not in caplog.text


def test_a_handover_is_no_contest(caplog):
    made = contest()
    for number in range(10):
        made.received("/nav", GO, 0.05 * number)
    for number in range(10):
        made.received("/teleop", TURN, 0.5 + 0.05 * number)
    made.received("/nav", GO, 5.0)
    assert made.report(5.0) == []
    assert "against" not in caplog.text


def test_a_contest_that_is_over_is_reported_no_longer():
    made = contest()
    now_s = alternate(made, GO, TURN)
    assert made.report(now_s + REPORTED_S / 2)
    assert made.report(now_s + REPORTED_S) == []


def test_any_number_of_senders_takes_bounded_room():
    made = contest()
    for number in range(1000):
        made.received(f"/node{number % (2 * SENDERS_MAX)}", (float(number),), 0.001 * number)
    assert len(made.report(1.0)) <= SENDERS_MAX


def gid(number):
    return SimpleNamespace(data=bytes([number]) * 16)


def test_an_endpoint_has_the_name_of_its_node_as_its_participant_last_reported():
    graph = Graph()
    node = SimpleNamespace(
        node_namespace="/", node_name="teleop", writer_gid_seq=[gid(2)], reader_gid_seq=[gid(3)]
    )
    graph.learn(SimpleNamespace(gid=gid(1), node_entities_info_seq=[node]))
    assert graph.name(bytes([2]) * 16) == graph.name(bytes([3]) * 16) == "/teleop"
    graph.learn(SimpleNamespace(gid=gid(1), node_entities_info_seq=[]))
    assert graph.name(bytes([2]) * 16) == "endpoint " + "02" * 16
    assert "gone" in graph.name(b"")
