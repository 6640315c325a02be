# SPDX-License-Identifier: Apache-2.0
"""The reason of a stop and its sender, in `status` and in the log."""

import os
from pathlib import Path

from tests.sim.daemon_stage import running, wait_until

from motord.api.stop_request import send

NAME = Path("/proc/self/comm").read_text(encoding="utf-8").strip()


def test_an_emergency_stop_keeps_its_reason_and_adds_later_ones(tmp_path):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        stage.robot.call("estop", why="a person is\ntoo close")
        found = stage.robot.status()["why"]
        assert found == [f"a person is?too close (process {os.getpid()}, {NAME})"]
        stage.robot.call("estop", why="a second person")
        stage.robot.call("estop", why="a second person")
        assert stage.robot.status()["why"] == [
            *found, f"a second person (process {os.getpid()}, {NAME})"
        ]  # fmt: skip
        assert f"emergency stop: {found[0]}" in stage.logged()


def test_a_stop_request_names_its_sender_until_the_call_gives_the_reason(tmp_path):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        send(stage.socket, "estop", 5.0)
        asked = f"requested by process {os.getpid()}, {NAME}"
        wait_until(lambda: stage.robot.status()["why"] == [asked], "the sender")
        stage.robot.call("estop", why="the button of the panel")
        assert stage.robot.status()["why"] == [
            f"the button of the panel (process {os.getpid()}, {NAME})"
        ]
