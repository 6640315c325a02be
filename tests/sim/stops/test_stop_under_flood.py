# SPDX-License-Identifier: Apache-2.0
"""Stop, emergency stop and disarm get through, whatever other clients do to the local socket, and
whatever resource the daemon lacks."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, set_off, wait_until

CONNECTOR = str(Path(__file__).with_name("connector.py"))
HOGGED = ("-m", "tests.sim.hogged_daemon")
IDLE_CONNECTIONS = 2000
STORMERS = 2
FAULT_LATCHED = 3
"""Exit status of a command while a fault is latched."""


@contextlib.contextmanager
def connectors(stage, count, processes=1):
    with contextlib.ExitStack() as cleanup:
        for _ in range(processes):
            process = cleanup.enter_context(
                subprocess.Popen(
                    [sys.executable, CONNECTOR, str(stage.socket), str(count)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
            )
            cleanup.callback(process.kill)
            assert process.stdout.readline() == b"there\n"
        yield


def motord(stage, *words):
    return subprocess.run(
        [sys.executable, "-m", "motord", *words, "--socket", str(stage.socket)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=4 * DEADLINE_S,
    )


def rests(stage):
    return stage.sim.truth().at_rest


def is_off(stage):
    return not any(joint.enabled for joint in stage.sim.truth().joints.values())


def at_rest_by(stage, method):
    """Run the command while a lease keeps the wheels turning; return the state that it prints, once
    the robot rests. The flood also slows the simulated drives: if a fault for their silence
    precedes the stop, return "fault"."""
    done = motord(stage, method)
    wait_until(lambda: rests(stage), f"rest after {method}")
    if done.returncode == FAULT_LATCHED and "feedback_stale" in done.stderr:
        wait_until(lambda: f"({method}, was" in stage.logged(), f"{method} is received")
        return "fault"
    assert done.returncode == 0, done.stderr + stage.logged()
    if method == "disarm":
        wait_until(lambda: is_off(stage), "the power is off")
    return done.stdout.strip()


@contextlib.contextmanager
def driven(stage):
    """Drive at speed with a new client, because other clients may close older connections."""
    with stage.client() as client:
        stage.robot.close()
        stage.robot = client
        set_off(stage)
        yield


@pytest.mark.parametrize(
    ("count", "processes"), [(0, STORMERS), (IDLE_CONNECTIONS, 1)], ids=["storm", "idle"]
)
def test_a_robot_is_stopped_through_a_flood_of_connections(tmp_path, count, processes):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        for method, states in (
            ("stop", ("armed", "fault")), ("disarm", ("idle",)), ("estop", ("estop",))
        ):  # fmt: skip
            with driven(stage), connectors(stage, count, processes):
                assert at_rest_by(stage, method) in states


@pytest.mark.parametrize("method", ["stop", "estop", "disarm"])
def test_a_daemon_out_of_descriptors_is_stopped(tmp_path, method):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        set_off(stage)
        highest = max(map(int, os.listdir(f"/proc/{stage.daemon.pid}/fd")))
        limits = resource.prlimit(stage.daemon.pid, resource.RLIMIT_NOFILE, (highest + 1,) * 2)
        with connectors(stage, highest):
            at_rest_by(stage, method)
        assert limits[1] > highest


@pytest.mark.parametrize(
    ("method", "state"), [("stop", "fault"), ("estop", "estop"), ("disarm", "idle")]
)
def test_a_daemon_with_a_hung_asyncio_is_stopped_by_the_loop(tmp_path, method, state):
    pipe = tmp_path / "hog"
    os.mkfifo(pipe)
    patient = ("safety.heartbeat_timeout_s=5.0", "safety.drive_watchdog_s=10.0")
    with running(tmp_path, *patient, motord=HOGGED, environ={"HOG_PIPE": str(pipe)}) as stage:
        stage.wait_for("idle")
        set_off(stage)
        stage.daemon.send_signal(signal.SIGUSR1)
        try:
            done = motord(stage, method)
            assert done.stdout.split() == [state], done.stderr
            wait_until(lambda: rests(stage), "rest")
            assert method == "stop" or wait_until(lambda: is_off(stage), "the power is off")
        finally:
            stage.daemon.kill()


def test_an_unreachable_daemon_is_answered_with_motord_stop_all(tmp_path):
    with running(tmp_path, simulated=False) as stage:
        pass
    done = motord(stage, "estop")
    assert done.returncode == 1
    assert "motord stop-all" in done.stderr
