# SPDX-License-Identifier: Apache-2.0
"""Whatever dies, the wheels come to rest: whole daemon, simulated drives, real signals.

Truth is the simulator's: how fast its wheels really turn. The bound of each test is the timeout
that must bite (the drive's own watchdog, or the command's lease) plus the ramp, plus BUSY_S for a
machine with other work; measured by the simulator's clock.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from motord.config import load_robot
from motord.tools.demo import staged

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "config/robots/demo.toml"
HOGGED = (sys.executable, str(Path(__file__).with_name("hogged_daemon.py")))
BUSY_S = 1.0
SPEED_M_S = 0.5

SOURCE = """
import sys, time
from motord.client import Client
with Client(sys.argv[1]) as robot:
    while True:
        robot.drive(float(sys.argv[2]), 0.0, owner="source")
        time.sleep(0.05)
"""


def robot_file():
    return load_robot(ROBOT)


def drive_ramp_s() -> float:
    """The simulated drive stops by itself at least as fast as this from the test's speed."""
    return 1.0


def core_ramp_s() -> float:
    limits = robot_file().limits
    return SPEED_M_S / limits.linear_deceleration_m_s2 + 0.5


@pytest.fixture
def stage():
    with staged(ROBOT, ["rs485"]) as stage:
        yield stage


def wait_until(condition, what, deadline_s=20.0):
    end = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end, f"{what}: not within {deadline_s} s"
        time.sleep(0.02)


def wheels_rad_s(stage):
    return [joint.velocity_rad_s for joint in stage.sim.truth().joints.values()]


def set_off(stage):
    """A source in a process of its own drives straight on; returns when the true wheels turn."""
    stage.wait("idle", lambda status: status["state"] == "idle", 20.0)
    stage.robot.arm()
    source = subprocess.Popen(
        [sys.executable, "-c", SOURCE, str(stage.socket), str(SPEED_M_S)],
        stderr=subprocess.DEVNULL,
    )
    wheel_radius_m = robot_file().base.wheel_radius_m
    fast_rad_s = 0.9 * SPEED_M_S / wheel_radius_m
    wait_until(lambda: min(map(abs, wheels_rad_s(stage))) > fast_rad_s, "the wheels turn")
    return source


def seconds_to_rest(stage, hurt, deadline_s=30.0):
    """From just before `hurt()` until the last wheel stood, by the simulator's own clock."""
    before_s = stage.sim.truth().time_s
    hurt()
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest", deadline_s)
    truth = stage.sim.truth()
    return truth.time_s - truth.rest_since_s - before_s


def test_when_the_daemon_is_killed_the_drives_stop_the_wheels(stage):
    source = set_off(stage)
    try:
        watchdog_s = robot_file().safety.drive_watchdog_s
        rest_s = seconds_to_rest(stage, stage.daemon.kill)
        assert rest_s < watchdog_s + drive_ramp_s() + BUSY_S
    finally:
        source.kill()
        source.wait()


def test_when_the_daemon_is_suspended_the_drives_stop_the_wheels(stage):
    source = set_off(stage)
    try:
        watchdog_s = robot_file().safety.drive_watchdog_s
        rest_s = seconds_to_rest(stage, lambda: stage.daemon.send_signal(signal.SIGSTOP))
        assert rest_s < watchdog_s + drive_ramp_s() + BUSY_S
        source.kill()
        stage.daemon.send_signal(signal.SIGCONT)
        stage.wait("a latched fault", lambda status: status["state"] == "fault", 20.0)
        assert stage.sim.truth().at_rest
    finally:
        source.kill()
        source.wait()


def test_when_the_command_source_is_killed_the_robot_ramps_to_rest(stage):
    source = set_off(stage)
    timeout_s = robot_file().safety.command_timeout_s
    rest_s = seconds_to_rest(stage, source.kill)
    source.wait()
    assert rest_s < timeout_s + core_ramp_s() + BUSY_S
    stage.wait("armed again", lambda status: status["state"] == "armed", 10.0)


def test_when_the_port_is_pulled_the_drives_stop_the_wheels_and_come_back_disarmed(stage):
    source = set_off(stage)
    try:
        watchdog_s = robot_file().safety.drive_watchdog_s
        rest_s = seconds_to_rest(stage, lambda: stage.sim.pull("rs485"))
        assert rest_s < watchdog_s + drive_ramp_s() + BUSY_S
        stage.wait("a latched fault", lambda status: status["state"] == "fault", 10.0)
        stage.sim.plug("rs485")
        stage.wait(
            "the line again", lambda status: status["lines"]["rs485"]["state"] == "ready", 20.0
        )
        assert stage.robot.status()["state"] == "fault"
        assert stage.sim.truth().at_rest
        assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
    finally:
        source.kill()
        source.wait()


def test_a_thread_that_hogs_the_gil_does_not_keep_the_wheels_turning(tmp_path, monkeypatch):
    pipe = tmp_path / "hog"
    os.mkfifo(pipe)
    monkeypatch.setenv("HOG_PIPE", str(pipe))
    with staged(ROBOT, ["rs485"], motord=HOGGED) as stage:
        source = set_off(stage)
        try:
            watchdog_s = robot_file().safety.drive_watchdog_s
            rest_s = seconds_to_rest(stage, lambda: pipe.write_text("now\n", encoding="ascii"), 8.0)
            assert rest_s < watchdog_s + drive_ramp_s() + BUSY_S
        finally:
            source.kill()
            source.wait()
        stage.wait("a latched fault after it", lambda status: status["state"] == "fault", 30.0)
        assert stage.robot.status()["faults"]
        assert stage.sim.truth().at_rest


def test_the_demonstration_ends_well_and_prints_what_the_contract_says():
    run = subprocess.run(
        [sys.executable, "-m", "motord", "demo", "--json", "--seconds", "8"],
        capture_output=True,
        text=True,
        timeout=90,
        cwd=ROOT,
    )
    assert run.returncode == 0, run.stderr
    result = json.loads(run.stdout)
    assert result["ok"] is True
    assert result["odometry"].keys() >= {
        "distance_m", "position_error_m", "heading_error_rad", "drift_percent",
    }  # fmt: skip
    assert result["loop"].keys() >= {
        "rate_hz",
        "ticks",
        "overruns",
        "lateness_us",
        "step_ns",
        "policy",
    }
    assert result["lines"]["rs485"].keys() >= {
        "exchanges", "errors", "cycle_hz", "wire_limit_hz", "round_trip_us",
    }  # fmt: skip
    assert result["safety"].keys() >= {"final_state", "faults", "stops"}
    assert result["engine"] == {"rs485": "asyncio"}
