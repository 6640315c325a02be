# SPDX-License-Identifier: Apache-2.0
"""The log of a daemon whose clients repeat a request without end."""

import pytest
from tests.sim.daemon_stage import armed, becomes_idle, running

FLOOD = 60
LINES_MAX = 25


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("daemon")) as stage:
        stage.wait_for("idle")
        yield stage


def logged_by(stage, act):
    """Return the lines that FLOOD calls of `act` add to the log."""
    before = len(stage.logged().splitlines())
    for number in range(FLOOD):
        act(number)
    return stage.logged().splitlines()[before:]


def test_stops_of_a_robot_at_rest_are_a_few_lines(stage):
    with armed(stage):
        lines = logged_by(stage, lambda _: stage.robot.stop())
    assert any("stopping (stop, was armed)" in line for line in lines)
    assert len(lines) <= LINES_MAX


def test_emergency_stops_with_ever_new_reasons_are_a_few_lines(stage):
    lines = logged_by(stage, lambda number: stage.robot.call("estop", why=f"reason {number}"))
    assert any("emergency stop: reason 0" in line for line in lines)
    assert len(lines) <= LINES_MAX
    assert any(f"reason {FLOOD - 1}" in why for why in stage.robot.status()["why"])
    becomes_idle(stage)
