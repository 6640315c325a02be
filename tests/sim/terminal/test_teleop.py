# SPDX-License-Identifier: Apache-2.0
"""`motord teleop` at a real pseudo-terminal, with a whole daemon on simulated drives."""

import contextlib
import signal
import subprocess
import sys
import time

import pytest
from tests.sim.daemon_stage import ROOT, SURE, UNHURRIED, rests, running, wait_until
from tests.sim.pseudo_terminal import at_terminal

from motord.client import ClientError

RELEASED_S = 1.5
"""Pause that is longer than a lease, and longer than the effect of one key press."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("teleop"), *SURE) as stage:
        stage.wait_for("idle")
        yield stage


@contextlib.contextmanager
def teleop(stage, **options):
    words = ("teleop", "--socket", str(stage.socket), "--first-s", "1.0")
    with at_terminal(*words, **options) as terminal:
        terminal.wait_until(
            lambda: "m/s" in terminal.text or "r resets" in terminal.text, "the status line"
        )
        yield terminal


def hold(stage, terminal, key="w"):
    """Hold a key until the wheels turn. On a slow machine keys get too old, or a fault is latched,
    which is reset here. After either a held key does not drive: release it and press it again."""
    seen = {"refusals": 0}

    def refusals():
        return sum(terminal.text.count(why) for why in ("slow link", "went on requesting"))

    def turning():
        if stage.state() == "fault":
            with contextlib.suppress(ClientError):
                stage.robot.reset()
                stage.robot.arm()
        if refusals() > seen["refusals"] and stage.state() != "fault":
            end_s = time.monotonic() + RELEASED_S
            terminal.wait_until(lambda: time.monotonic() > end_s, "silence")
            seen["refusals"] = refusals()
        return not stage.sim.truth().at_rest

    terminal.wait_until(turning, "the wheels turn", keys=key)


def test_a_held_key_drives_and_its_release_stops(armed):
    with teleop(armed) as terminal:
        hold(armed, terminal)
        terminal.wait_until(lambda: armed.sim.truth().at_rest, "the wheels rest")
        hold(armed, terminal, "\x1b[D")
        terminal.wait_until(lambda: armed.sim.truth().at_rest, "the wheels rest")
        assert armed.robot.status()["leases"] == []
        terminal.type("x")
        assert terminal.exit_status() == 0
        assert terminal.settings == terminal.before
    assert armed.state() == "armed"


def test_two_keys_move_a_base_sideways(tmp_path):
    with running(tmp_path, *UNHURRIED, robot=ROOT / "config/robots/omni3.toml") as stage:
        stage.wait_for("idle")
        stage.robot.arm()
        with teleop(stage) as terminal:
            hold(stage, terminal, "z")
            terminal.wait_until(lambda: stage.sim.truth().y_m > 0.01, "to the left", keys="z")
            rests(stage)
            truth = stage.sim.truth()
            assert abs(truth.x_m) < 0.2 * truth.y_m
            terminal.type("x")
            assert terminal.exit_status() == 0


def test_keys_delayed_by_a_slow_link_move_nothing(armed):
    with teleop(armed) as terminal:
        hold(armed, terminal)
        terminal.answers = False  # the link hangs, and the key is released
        rests(armed)
        terminal.wait_until(lambda: not armed.robot.status()["leases"], "no lease")
        accepted = armed.robot.status()["commands"]["accepted"]
        terminal.type("w" * 4)
        terminal.type("w")
        terminal.wait_for("slow link")
        terminal.type("x")
        assert terminal.exit_status() == 0
    assert armed.sim.truth().at_rest
    assert armed.robot.status()["commands"]["accepted"] - accepted <= 1  # zero at the end


def test_the_space_bar_is_an_emergency_stop(armed):
    with teleop(armed) as terminal:
        hold(armed, terminal)
        terminal.type(" ")
        terminal.wait_for("emergency stop: estop")
        rests(armed)
        terminal.type("\x03")
        assert terminal.exit_status() == 3
        assert terminal.settings == terminal.before


def test_a_motion_key_during_an_emergency_stop_is_refused_and_the_session_goes_on(armed):
    with teleop(armed) as terminal:
        terminal.type(" ")
        terminal.wait_for("emergency stop: estop")
        terminal.wait_for("estop, r resets: requested by")
        rests(armed)
        refused = "so the robot does not move"
        terminal.wait_until(lambda: refused in terminal.text, "the refusal", keys="w")
        # refused until the wheels rest
        terminal.wait_until(lambda: "reset: idle" in terminal.text, "the reset", keys="r")
        terminal.wait_for("m arms")
        terminal.type("x")
        assert terminal.exit_status() == 0
    assert armed.sim.truth().at_rest


def test_a_robot_armed_by_teleop_is_disarmed_at_its_end(stage):
    wait_until(lambda: stage.state() in ("idle", "fault", "estop"), "at rest")
    with teleop(stage) as terminal:
        terminal.type("r")
        terminal.wait_for("reset:")
        terminal.type("m")
        terminal.wait_for("arm: armed")
        terminal.process.send_signal(signal.SIGTERM)
        assert terminal.exit_status() == 1
        assert "ended by SIGTERM" in terminal.text
        assert terminal.settings == terminal.before
    assert not stage.robot.status()["armed"]


def test_a_closed_terminal_ends_at_rest(armed):
    with teleop(armed) as terminal:
        hold(armed, terminal)
        terminal.hang_up()
        rests(armed)
        terminal.process.wait(100)
    assert armed.robot.status()["leases"] == []


def test_a_suspended_teleop_stops_the_robot(armed):
    with teleop(armed) as terminal:
        hold(armed, terminal)
        terminal.process.send_signal(signal.SIGSTOP)
        for _ in range(5):
            terminal.type("w")  # the key waits in the terminal's buffer
        rests(armed)
        accepted = armed.robot.status()["commands"]["accepted"]
        terminal.type("x")  # it takes effect although it was pressed before SIGCONT
        terminal.process.send_signal(signal.SIGCONT)
        terminal.exit_status()
        assert armed.robot.status()["commands"]["accepted"] - accepted <= 2


def test_a_lost_daemon_ends_it_and_the_robot_rests(armed):
    with teleop(armed) as terminal:
        hold(armed, terminal)
        armed.daemon.send_signal(signal.SIGSTOP)
        try:
            assert terminal.exit_status() == 1
            rests(armed)  # the watchdog of the drives stops it
            assert terminal.settings == terminal.before
        finally:
            armed.daemon.send_signal(signal.SIGCONT)
    armed.wait_for("fault", "armed", "idle", "moving")


def test_without_a_terminal_it_is_wrong_usage(stage):
    done = subprocess.run(
        [sys.executable, "-m", "motord", "teleop", "--socket", str(stage.socket)],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, start_new_session=True,
        timeout=100,
    )  # fmt: skip
    assert done.returncode == 2
    assert "ssh -t" in done.stderr
