# SPDX-License-Identifier: Apache-2.0
"""How a daemon starts, ends and notifies its supervisor: each test has its own daemon."""

import json
import os
import signal
import socket
import subprocess
from pathlib import Path

import pytest
from tests.sim.daemon_stage import DEADLINE_S, running, set_off, wait_until

from motord.client import Refused

FAULT = 3


@pytest.fixture
def supervisor(tmp_path):
    """Socket on which a service manager receives the messages of sd_notify."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(DEADLINE_S)
        yield listener


def received_until(listener, last):
    received = []
    while not received or received[-1] != last:
        received.append(listener.recv(1000).decode())
    return received


def moving(stage):
    """Wait for idle, then arm and drive at 0.5 m/s."""
    stage.wait_for("idle")
    set_off(stage, 0.5)


def test_a_supervisor_is_notified_of_ready_watchdog_and_stopping(tmp_path, supervisor):
    environ = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
    with running(tmp_path, environ=environ) as stage:
        received = received_until(supervisor, "STATUS=idle")
        assert "READY=1" in received
        received_until(supervisor, "WATCHDOG=1")
        stage.daemon.send_signal(signal.SIGTERM)
        received = received_until(supervisor, "STATUS=off")
        assert "STOPPING=1" in received
        assert stage.daemon.wait(DEADLINE_S) == 0


def test_a_daemon_that_hangs_feeds_no_watchdog(tmp_path, supervisor):
    environ = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
    with running(tmp_path, environ=environ) as stage:
        received_until(supervisor, "WATCHDOG=1")
        stage.daemon.send_signal(signal.SIGSTOP)
        supervisor.settimeout(0.5)
        with pytest.raises(TimeoutError):
            while True:  # messages sent before the stop
                supervisor.recv(1000)
        stage.daemon.send_signal(signal.SIGCONT)
        supervisor.settimeout(DEADLINE_S)
        received_until(supervisor, "WATCHDOG=1")


@pytest.mark.parametrize(
    "number",
    [
        *(signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2),
        *(signal.SIGALRM, signal.SIGPWR, signal.SIGRTMAX),
    ],
)
def test_it_ends_at_rest_and_without_power(tmp_path, number):
    with running(tmp_path) as stage:
        moving(stage)
        assert stage.end(number) == 0
        truth = stage.sim.truth()
        assert truth.at_rest
        assert not any(joint.enabled for joint in truth.joints.values())
        assert not stage.socket.exists()
        log = stage.logged()
        assert log.index("comes to rest") < log.index("off (shutdown") < log.index("ended")


@pytest.mark.parametrize("number", [signal.SIGTTIN, signal.SIGTTOU, signal.SIGPIPE, signal.SIGXFSZ])
def test_a_signal_about_its_output_neither_ends_nor_freezes_it(tmp_path, number):
    with running(tmp_path) as stage:
        moving(stage)
        stage.daemon.send_signal(number)
        tick = stage.robot.status()["loop"]["ticks"]
        wait_until(lambda: stage.robot.status()["loop"]["ticks"] > tick + 100, "ticks")
        assert stage.daemon.poll() is None


def test_a_daemon_that_failed_to_switch_its_drives_off_reports_it(tmp_path):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        stage.robot.arm()
        stage.sim.pull("rs485")
        assert stage.end() == FAULT
        log = stage.logged()
        assert "ended, but not all drives are known to be without power: " in log
        assert "at rest and disarmed" not in log


def test_a_line_that_is_lost_before_a_forced_end_is_status_3(tmp_path):
    with running(tmp_path, *SLOW_RAMP) as stage:
        moving(stage)
        stage.daemon.send_signal(signal.SIGTERM)
        wait_until(lambda: "comes to rest" in stage.logged(), "the first signal")
        stage.robot.close()
        stage.sim.pull("rs485")
        assert stage.end() == FAULT
        assert "not all drives are known to be without power" in stage.logged()


SLOW_RAMP = ("limits.linear_deceleration_m_s2=0.06", "limits.linear_m_s3=inf")


def status_without_the_ramp(stage, *faults):
    """Return the exit status after a second signal, which ends the ramp: the lines stop their
    drives as they end, while these faults disturb them."""
    moving(stage)
    stage.daemon.send_signal(signal.SIGTERM)
    wait_until(lambda: "comes to rest" in stage.logged(), "the first signal")
    stage.robot.close()
    for fault in faults:
        stage.sim.inject(fault)
    status = stage.end()
    assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    return status


def test_a_second_signal_cuts_the_power_without_waiting_for_the_ramp(tmp_path):
    with running(tmp_path, *SLOW_RAMP) as stage:
        assert status_without_the_ramp(stage) == 0


def test_a_task_that_fails_during_shutdown_does_not_cut_the_stop_short(tmp_path):
    failing = ("-m", "tests.sim.failing_daemon")
    settings = (*SLOW_RAMP, "safety.drive_watchdog_s=10.0")
    with running(tmp_path, *settings, motord=failing) as stage:
        assert status_without_the_ramp(stage, "silence:for_s=0.3") != 0
        assert "a mistake at the end" in stage.logged()


def test_a_base_that_coasts_when_the_command_ends_is_disarmed(tmp_path):
    with running(tmp_path, "safety.on_timeout=coast") as stage:
        moving(stage)
        stage.wait_for("idle")
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
        assert stage.logged().count("disarmed by itself") == 1
        assert stage.robot.status()["faults"] == []


def test_without_a_port_it_waits_logs_it_once_and_ends_with_status_3(tmp_path):
    with running(tmp_path, simulated=False) as stage:
        wait_until(lambda: "nothing" in stage.logged(), "the port is missed")
        with pytest.raises(Refused, match="not ready"):
            stage.robot.arm()
        found = stage.robot.status()
        assert found["state"] == "configuring"
        assert found["lines"]["rs485"]["state"] == "closed"
        assert stage.end() == FAULT
        assert (
            len([line for line in stage.logged().splitlines() if "there is no such port" in line])
            == 1
        )


def test_one_json_object_reports_the_socket_and_the_state_page(tmp_path):
    with running(tmp_path, simulated=False, stdout=subprocess.PIPE, options=("--json",)) as stage:
        ready = json.loads(stage.daemon.stdout.readline())
        assert ready["pid"] == stage.daemon.pid
        assert ready["socket"] == str(stage.socket)
        assert Path(ready["state_page"]).exists()
        assert stage.end() == FAULT
        stage.daemon.stdout.close()
    assert not Path(ready["state_page"]).exists()


def test_a_stuck_reader_of_its_output_does_not_keep_it_from_driving(tmp_path):
    reading, writing = os.pipe()
    settings = ("publish.console.kind=stdout", "publish.console.rate_hz=500", "loop.rate_hz=1000")
    with (
        os.fdopen(reading),
        os.fdopen(writing) as stuck,
        running(tmp_path, *settings, stdout=stuck) as stage,
    ):
        wait_until(
            lambda: stage.robot.status()["publishers"]["console"]["taken"] > 100, "snapshots"
        )
        moving(stage)
        assert stage.robot.stop() == "armed"
        assert stage.end() == 0


def test_snapshots_come_on_standard_output_and_by_udp(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(DEADLINE_S)
        port = listener.getsockname()[1]
        radio = ("publish.radio.kind=udp", f"publish.radio.port={port}", "publish.radio.rate_hz=20")
        console = "publish.console.kind=stdout"
        with running(tmp_path, *radio, console, stdout=subprocess.PIPE) as stage:
            datagram = json.loads(listener.recv(65536))
            line = json.loads(stage.daemon.stdout.readline())
            assert datagram.keys() == line.keys() >= {"robot", "wall_time_s", "tick", "joints"}
            assert datagram["robot"] == stage.robot.status()["robot"]
            stage.daemon.stdout.close()
            stage.wait_for("idle")
            assert stage.end() == 0
