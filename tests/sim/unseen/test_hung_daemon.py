# SPDX-License-Identifier: Apache-2.0
"""A daemon hangs as a whole while its robot drives: the commands notice it at once, and stop the
drives without it. The drives' own watchdogs are too long to help."""

import json
import signal
import subprocess
import sys
import time

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, set_off, wait_until

from motord.client import TIMEOUT_S

LONG = "safety.drive_watchdog_s=10"
SPEED_M_S = 0.5


def motord(*words):
    return subprocess.run(
        [sys.executable, "-m", "motord", *map(str, words)],
        capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT,
    )  # fmt: skip


@pytest.fixture
def stage(where_it_looks, own_file):
    with running(where_it_looks, LONG, robot=own_file) as stage:
        stage.wait_for("idle")
        set_off(stage, SPEED_M_S)
        yield stage


def hang(stage):
    stage.daemon.send_signal(signal.SIGSTOP)


def drives_are_off(stage):
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    return not any(joint.enabled for joint in stage.sim.truth().joints.values())


@pytest.mark.parametrize("method", ["estop", "stop", "disarm"])
def test_a_command_that_stops_names_the_process_of_a_daemon_that_hangs(stage, method):
    hang(stage)
    before_s = time.monotonic()
    done = motord(method, "--socket", stage.socket)
    assert time.monotonic() - before_s < TIMEOUT_S, "it does not wait for an answer"
    assert done.returncode == 1
    first, last = done.stderr.splitlines()
    assert f"process {stage.daemon.pid}, stopped by a signal" in first
    assert "stood still" in first
    assert "motord estop --force" in last
    assert stage.daemon.poll() is None


def test_a_daemon_that_goes_on_in_time_answers_the_command(stage):
    hang(stage)
    command = [sys.executable, "-m", "motord", "estop", "--socket", str(stage.socket)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as estop:
        assert "hangs" in estop.stderr.readline()
        stage.daemon.send_signal(signal.SIGCONT)
        assert estop.wait(DEADLINE_S) == 0, estop.stderr.read()
    assert stage.state() == "estop"


def test_stop_all_ends_a_daemon_that_hangs_and_stops_its_drives(stage, own_file, where_it_looks):
    hang(stage)
    done = motord("stop-all", own_file, "--json")
    assert (done.returncode, json.loads(done.stdout)["ok"]) == (0, True), done.stderr
    assert f"process {stage.daemon.pid}" in done.stderr
    assert stage.daemon.wait(DEADLINE_S) == -signal.SIGKILL
    assert drives_are_off(stage)
    assert not list(where_it_looks.glob("*.running"))


def test_a_forced_emergency_stop_ends_a_daemon_that_hangs_and_stops_its_drives(
    stage, where_it_looks
):
    hang(stage)
    done = motord("estop", "--force", "--socket", stage.socket, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["state"] == "off"
    assert stage.daemon.wait(DEADLINE_S) == -signal.SIGKILL
    assert drives_are_off(stage)
    assert not list(where_it_looks.glob("*.running"))


def test_a_daemon_that_ticks_is_not_ended(stage, own_file):
    done = motord("stop-all", own_file)
    assert done.returncode == 1
    assert "runs" in done.stderr
    assert "use motord estop" in done.stderr
    done = motord("estop", "--force", "--socket", stage.socket)
    assert (done.returncode, done.stdout) == (0, "estop\n"), done.stderr
    assert stage.state() == "estop"
    assert stage.daemon.poll() is None


def test_stop_all_does_not_end_a_daemon_that_was_started_with_another_file(stage, own_file):
    other = own_file.with_name("other.toml")
    other.write_text(own_file.read_text(encoding="utf-8"), encoding="utf-8")
    name = stage.robot.status()["robot"]
    hang(stage)
    done = motord("stop-all", other, "--set", f"robot.name={name}")
    assert done.returncode == 1
    assert "not started with this robot file" in done.stderr
    assert stage.daemon.poll() is None


def test_a_broken_drive_profile_is_found_before_a_daemon_is_ended(stage, where_it_looks):
    (kept,) = where_it_looks.glob("*.running")
    ran = json.loads(kept.read_text(encoding="utf-8"))
    kept.write_text(json.dumps({**ran, "text": "[robot"}), encoding="utf-8")
    hang(stage)
    done = motord("estop", "--force", "--socket", stage.socket)
    assert done.returncode == 2
    assert stage.daemon.poll() is None
