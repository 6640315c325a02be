# SPDX-License-Identifier: Apache-2.0
"""`motord top` at a real pseudo-terminal of 80 × 24, with a whole daemon on simulated drives."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, becomes_idle, obeying, running, wait_until
from tests.sim.pseudo_terminal import at_terminal

pytest.importorskip("textual")


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("top"), "input.socket.kind=socket") as stage:
        stage.wait_for("idle")
        yield stage


@contextlib.contextmanager
def top(stage):
    """Run `motord top` on an idle robot; yield its terminal."""
    becomes_idle(stage)
    with at_terminal("top", "--socket", str(stage.socket), answers=False) as terminal:
        terminal.wait_for("joint")
        yield terminal


@pytest.mark.long
def test_it_shows_the_robot_and_its_keys_act(stage):
    with top(stage) as terminal:
        for text in ("IDLE", "left", "right", "rs485", "cycles/s", "loop", "no source", "socket"):
            terminal.wait_for(text)
        terminal.type("a")
        terminal.wait_for("Power the drives?")
        assert stage.state() == "idle"
        terminal.type("n")
        terminal.wait_until(lambda: stage.state() == "armed", "armed", keys="ay")
        obeying(stage, lambda may: may and stage.robot.drive(0.2, 0.0))
        terminal.wait_until(lambda: stage.robot.drive(0.2, 0.0) and "MOVING" in terminal.text, "it")
        terminal.type(" ")  # this key acts without a question
        terminal.wait_until(lambda: stage.state() == "estop", "the emergency stop")
        terminal.wait_for("ESTOP")
        terminal.wait_for("r resets")
        # refused until the wheels rest
        terminal.wait_until(lambda: stage.state() == "idle", "the reset", keys="r")
        terminal.type("q")
        assert terminal.exit_status() == 0
        assert terminal.settings == terminal.before


def test_sigterm_restores_the_terminal(stage):
    with top(stage) as terminal:
        terminal.process.send_signal(signal.SIGTERM)
        assert terminal.exit_status() == 0
        assert terminal.settings == terminal.before


def test_an_emergency_stop_does_not_wait_for_a_daemon_that_stands_still(stage):
    with top(stage) as terminal:
        terminal.wait_for("pose")
        stage.daemon.send_signal(signal.SIGSTOP)
        try:
            terminal.wait_for("NO ANSWER")
            before = len(terminal.text)
            terminal.type(" ")
            terminal.wait_for("emergency stop ...")  # its datagram waits for the loop
        finally:
            stage.daemon.send_signal(signal.SIGCONT)
        terminal.wait_until(lambda: stage.state() == "estop", "the emergency stop")
        terminal.wait_until(lambda: "pose" in terminal.text[before:], "the robot again")
        terminal.type("q")
        assert terminal.exit_status() == 0


def test_without_a_terminal_it_is_wrong_usage(stage):
    words = [sys.executable, "-m", "motord", "top", "--socket", str(stage.socket)]
    done = subprocess.run(
        words, stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd=ROOT,
        timeout=DEADLINE_S,
    )  # fmt: skip
    assert (done.returncode, "ssh -t" in done.stderr) == (2, True)


def test_the_log_is_read_by_record_number(stage):
    def found():
        return stage.robot.call("log")

    recent = wait_until(lambda: found()["records"] and found(), "a record")
    first, last = recent["records"][0], recent["records"][-1]
    assert set(first) == {"number", "time_s", "level", "text"}
    assert last["number"] == recent["newest"]
    later = stage.robot.call("log", after=first["number"])["records"]
    assert later[0]["number"] == first["number"] + 1
    assert os.fspath(stage.socket) in " ".join(record["text"] for record in recent["records"])
