# SPDX-License-Identifier: Apache-2.0
"""Exit statuses of the commands that talk to a daemon: 0 done, 1 it failed, 2 wrong usage, 3 a
fault is latched or hardware is missing."""

import contextlib
import json
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until

from motord.client import ClientError


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("exit")) as stage:
        stage.wait_for("idle")
        yield stage


def let_go(stage):
    """Send the zero with which the owner of a refused or stopped command may move again."""
    stage.robot.drive(0.0, 0.0, owner="motord-drive")
    stage.robot.release("motord-drive")


@pytest.fixture
def idle(stage):
    def rests():
        for call in (stage.robot.reset, stage.robot.disarm):
            with contextlib.suppress(ClientError):
                call()
        return stage.state() == "idle"

    wait_until(rests, "idle")
    let_go(stage)
    return stage


def command(stage, *words):
    return subprocess.Popen(
        [sys.executable, "-m", "motord", *words, "--json", "--socket", str(stage.socket)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip


def ended(process):
    """Wait until the command ends; return its exit status and the one object that it printed."""
    out, _ = process.communicate(timeout=DEADLINE_S)
    return process.returncode, json.loads(out)


@pytest.mark.parametrize("words", [("drive", "0.1", "0"), ("move", "1"), ("turn", "1")])
def test_a_motion_of_a_disarmed_robot_fails(idle, words):
    status, found = ended(command(idle, *words))
    assert (status, found["exit_status"]) == (1, 1)
    assert "armed" in found["error"] or "motord arm" in found["error"]


@pytest.mark.parametrize(
    "words",
    [("arm",), ("drive", "0.1", "0"), ("drive", "0", "0", "--seconds", "0.1"), ("move", "1"),
     ("turn", "1"), ("stop",), ("disarm",), ("status",), ("reset-odometry",)],
)  # fmt: skip
def test_each_command_reports_that_a_fault_is_latched(idle, words):
    idle.robot.estop()
    assert ended(command(idle, *words))[0] == 3
    idle.robot.reset()


@pytest.mark.parametrize(
    "words", [("arm",), ("reset",), ("drive", "0.1", "0"), ("move", "1"), ("turn", "1")]
)
def test_each_command_reports_that_hardware_is_missing(tmp_path_factory, words, unplugged):
    status, found = ended(command(unplugged, *words))
    assert (status, found["exit_status"]) == (3, 3)


@pytest.fixture(scope="module")
def unplugged(tmp_path_factory):
    with running(tmp_path_factory.mktemp("unplugged"), simulated=False) as stage:
        stage.wait_for("configuring")
        yield stage


@pytest.mark.parametrize(
    "words",
    [("params", "set", "limits.linear_m_s=-1"), ("params", "get", "limits.speed"),
     ("params", "set", "limits.linear_m_s"), ("move", "0"), ("drive", "nan", "0")],
)  # fmt: skip
def test_an_invalid_argument_is_wrong_usage_in_every_state(idle, words):
    assert ended(command(idle, *words))[0] == 2
    idle.robot.estop()
    assert ended(command(idle, *words))[0] == 2
    idle.robot.reset()


def test_a_drive_command_that_was_never_in_command_fails(idle):
    idle.robot.drive(0.0, 0.0, owner="me", priority=250, lease_s=5.0)
    status, found = ended(command(idle, "drive", "0", "0", "--seconds", "0.2"))
    idle.robot.release("me")
    assert (status, found["error"]) == (1, "me is in command")


def test_a_fault_that_ends_a_drive_command_is_its_exit_status(idle):
    started = []
    with contextlib.ExitStack() as processes:

        def turn():
            """Whether the wheels turn; a command that a busy machine ended is started again."""
            if not started or started[-1].poll() is not None:
                for call in (idle.robot.reset, idle.robot.arm):
                    with contextlib.suppress(ClientError):
                        call()
                let_go(idle)
                started.append(processes.enter_context(command(idle, "drive", "0.2", "0")))
            return not idle.sim.truth().at_rest

        wait_until(turn, "the wheels turn")
        idle.robot.estop()
        status, found = ended(started[-1])
        started[-1].kill()
    assert (status, found["exit_status"]) == (3, 3)
