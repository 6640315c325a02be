# SPDX-License-Identifier: Apache-2.0
"""Whatever dies, the wheels come to rest: whole daemon, simulated drives, real signals.

The simulator reports how fast its wheels really turn, by its own clock. The bound of each test is
the timeout that must act (the drive's own watchdog, or the command's lease) plus the ramp, plus
BUSY_S for a machine with other work.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.fork_server import started_from_nothing
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, ROOT, SLOW, SURE, running, wait_until
from tests.sim.stops.stopping_rig import BUSY_S, HOGGED, SPEED_M_S, moving, powered, seconds_to_rest

from motord.config import load_robot

WATCHDOG_S = 0.5
WATCHDOG = f"safety.drive_watchdog_s={WATCHDOG_S}"
DRIVE_RAMP_S = 0.2  # 0.5 m/s at the simulated drive's own 40 rad/s2


@pytest.fixture(scope="module")
def robot():
    return load_robot(ROBOT)


@pytest.fixture
def stage(tmp_path):
    with running(tmp_path, WATCHDOG) as stage:
        yield stage


def test_when_the_daemon_is_killed_the_drives_stop_the_wheels(stage, robot):
    with moving(stage, robot):
        rest_s = seconds_to_rest(stage, stage.daemon.kill)
        assert rest_s < WATCHDOG_S + DRIVE_RAMP_S + BUSY_S


def test_when_the_daemon_is_suspended_the_drives_stop_the_wheels(stage, robot):
    with moving(stage, robot) as source:
        rest_s = seconds_to_rest(stage, lambda: stage.daemon.send_signal(signal.SIGSTOP))
        assert rest_s < WATCHDOG_S + DRIVE_RAMP_S + BUSY_S
        source.kill()
        stage.daemon.send_signal(signal.SIGCONT)
        stage.wait_for("fault")
        assert stage.sim.truth().at_rest


def test_when_the_command_source_is_killed_the_robot_ramps_to_rest(stage, robot):
    timeout_s = robot.safety.command_timeout_s
    ramp_s = (
        SPEED_M_S / robot.limits.linear_deceleration_m_s2
        + 2 * robot.limits.linear_deceleration_m_s2 / robot.limits.linear_m_s3
    )
    with moving(stage, robot) as source:
        assert seconds_to_rest(stage, source.kill) < timeout_s + ramp_s + BUSY_S
        stage.wait_for("armed")


def test_when_the_port_is_pulled_the_drives_stop_and_come_back_disarmed(stage, robot):
    with moving(stage, robot):
        rest_s = seconds_to_rest(stage, lambda: stage.sim.pull("rs485"))
        assert rest_s < WATCHDOG_S + DRIVE_RAMP_S + BUSY_S
        stage.wait_for("fault")
        stage.sim.plug("rs485")
        wait_until(
            lambda: stage.robot.status()["lines"]["rs485"]["state"] == "ready", "the line again"
        )
        assert stage.state() == "fault"
        assert stage.sim.truth().at_rest
        assert not any(joint.enabled for joint in stage.sim.truth().joints.values())


def test_a_thread_that_hogs_the_gil_does_not_keep_the_wheels_turning(tmp_path, robot):
    pipe = tmp_path / "hog"
    os.mkfifo(pipe)
    hogged = {"HOG_PIPE": str(pipe)}
    with running(tmp_path, WATCHDOG, motord=HOGGED, environ=hogged) as stage:
        with moving(stage, robot):
            rest_s = seconds_to_rest(stage, lambda: pipe.write_bytes(b"now\n"))
            assert rest_s < WATCHDOG_S + DRIVE_RAMP_S + BUSY_S
        stage.wait_for("fault")
        assert stage.robot.status()["faults"]
        assert stage.sim.truth().at_rest


HEARTBEAT_S = 0.5


@pytest.mark.parametrize("how", ["GIL", "asyncio"])
def test_without_python_the_line_itself_brings_the_wheels_to_rest(tmp_path, robot, how):
    """The line's frames stop the wheels: the drives' watchdogs would act long after the bound."""
    pipe = tmp_path / "hog"
    os.mkfifo(pipe)
    settings = (f"safety.heartbeat_timeout_s={HEARTBEAT_S}", "safety.drive_watchdog_s=10.0")
    ramp_s = SPEED_M_S / robot.limits.linear_deceleration_m_s2

    with running(tmp_path, *settings, motord=HOGGED, environ={"HOG_PIPE": str(pipe)}) as stage:

        def hurt():
            if how == "GIL":
                pipe.write_bytes(b"now\n")
            else:
                stage.daemon.send_signal(signal.SIGUSR1)

        with moving(stage, robot):
            assert stage.robot.status()["lines"]["rs485"]["engine"] == "rt"
            assert seconds_to_rest(stage, hurt) < HEARTBEAT_S + ramp_s + BUSY_S
        wait_until(lambda: not powered(stage), "their power is off", 5.0)
        stage.daemon.kill()


def test_a_demonstration_that_is_terminated_leaves_no_process_behind(tmp_path):
    name = f"ended{os.getpid()}"
    robot = tmp_path / f"{name}.toml"
    robot.write_text(ROBOT.read_text(encoding="utf-8"), encoding="utf-8")

    def others():
        commands = []
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                commands.append((process / "cmdline").read_text("utf-8").split("\0"))
        return [words for words in commands if str(robot) in words and "demo" not in words]

    demo = subprocess.Popen([sys.executable, "-m", "motord", "demo", "--robot", robot], cwd=ROOT)
    try:
        for kind in ("run", "simulate"):
            wait_until(lambda kind=kind: any(kind in words for words in others()), kind)
        demo.terminate()
        demo.wait(DEADLINE_S)
        wait_until(lambda: not others(), "their end")
    finally:
        demo.kill()


@pytest.mark.long
def test_the_demonstration_succeeds_and_prints_every_key_of_the_contract(tmp_path):
    patient = tmp_path / "demo.toml"  # a delay by a busy machine is no fault
    text = ROBOT.read_text(encoding="utf-8")
    for old in ("feedback_timeout_s = 0.25", "heartbeat_timeout_s = 0.5", "drive_watchdog_s = 0.5"):
        assert old in text
        text = text.replace(old, old.split(" = ")[0] + " = 2.0")
    patient.write_text(text, encoding="utf-8")
    settings = [f"--set={setting}" for setting in (*SLOW, *SURE)]
    command = [sys.executable, "-m", "motord", "demo", "--json", "--seconds", "5", *settings]
    with started_from_nothing():
        run = subprocess.run(
            [*command, "--robot", patient], capture_output=True, text=True, timeout=200, cwd=ROOT
        )
    assert run.returncode == 0, run.stderr
    result = json.loads(run.stdout)
    assert result["ok"] is True
    wanted = {
        "robot": (),
        "seconds": (),
        "engine": ("rs485",),
        "odometry": ("distance_m", "position_error_m", "heading_error_rad", "drift_percent"),
        "loop": ("rate_hz", "ticks", "overruns", "lateness_us", "step_ns", "policy"),
        "lines": ("rs485",),
        "safety": ("final_state", "faults", "stops"),
    }
    assert result.keys() >= wanted.keys()
    for key, inner in wanted.items():
        assert not inner or result[key].keys() >= set(inner)
    assert result["loop"]["lateness_us"].keys() >= {"p50", "p99", "p99_9", "max"}
    assert result["loop"]["step_ns"].keys() >= {"p50", "p99", "max"}
    line = result["lines"]["rs485"]
    assert line.keys() >= {"exchanges", "errors", "cycle_hz", "wire_limit_hz", "round_trip_us"}
    assert line["round_trip_us"].keys() >= {"p50", "p99", "max"}


def test_an_answered_stop_is_not_repeated_by_its_datagram(tmp_path):
    """A client sends each stop to the loop, which reads once in a tick, and to asyncio."""
    with running(tmp_path, "loop.rate_hz=20") as stage:
        stage.wait_for("idle")
        for _ in range(5):
            assert stage.robot.estop() == "estop"
            assert stage.robot.disarm() == "estop"
            assert stage.robot.reset() == "idle"
            assert stage.robot.arm() == "armed"
            assert stage.robot.stop() == "armed"
            assert stage.robot.disarm() == "idle"
            assert stage.robot.arm() == "armed"
            tick = stage.robot.status()["loop"]["ticks"]
            wait_until(lambda tick=tick: stage.robot.status()["loop"]["ticks"] > tick + 3, "ticks")
            assert stage.state() == "armed"
