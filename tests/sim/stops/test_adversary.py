# SPDX-License-Identifier: Apache-2.0
"""Hostile clients and failures: none may move a wheel, and none may keep a wheel from stopping."""

import contextlib
import fcntl
import json
import os
import signal
import socket
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, ROOT, running, set_off, wait_until

from motord.client import Client, ClientError, Refused

SKID = ROOT / "config/robots/skid4.toml"
FORWARD_ONLY = ROOT / "config/robots/forward-only.toml"
TWO_SINGLE_DRIVES = ROOT / "config/robots/two-single-drives.toml"
SLOW_RAMP = ("limits.linear_deceleration_m_s2=0.1", "limits.linear_m_s3=inf")
STILL_RAD_S = 0.05


def wheels_rad_s(stage):
    return [abs(joint.velocity_rad_s) for joint in stage.sim.truth().joints.values()]


def powered(stage):
    return any(joint.enabled for joint in stage.sim.truth().joints.values())


def reset(stage):
    """Reset; repeat it until it is accepted, because a drive may still be in its set-up."""

    def taken():
        with contextlib.suppress(Refused):
            return stage.robot.reset() == "idle"

    wait_until(taken, "the reset")


def raw_connection(stage):
    peer = socket.socket(socket.AF_UNIX)
    peer.settimeout(DEADLINE_S)
    peer.connect(str(stage.socket))
    return peer


def request(number, method, **params):
    call = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
    return json.dumps(call).encode() + b"\n"


def test_pending_calls_do_not_refuse_an_emergency_stop(tmp_path):
    with running(tmp_path, *SLOW_RAMP) as stage, raw_connection(stage) as peer:
        set_off(stage)
        calls = b"".join(request(number, "stop") for number in range(8))
        peer.sendall(calls + request("now", "estop"))
        stage.wait_for("estop")
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        with peer.makefile() as answers:
            answer = next(a for a in map(json.loads, answers) if a["id"] == "now")
        assert answer["result"]["state"] == "estop"


def test_a_disarm_waits_for_the_ramp_of_a_fault(tmp_path):
    """Without the ramp a wheel would lose its power in motion, and coast."""
    with running(tmp_path, *SLOW_RAMP, robot=SKID) as stage:
        set_off(stage)
        stage.sim.inject("silence:unit=2,for_s=1000")
        stage.wait_for("fault")
        with pytest.raises(Refused, match="power-off is not confirmed"):
            stage.robot.disarm()  # the rear drives do not answer
        front = [stage.sim.truth().joints[name] for name in ("front_left", "front_right")]
        assert all(abs(joint.velocity_rad_s) < STILL_RAD_S for joint in front)
        assert not any(joint.enabled for joint in front)


def test_an_unread_log_does_not_hold_up_the_robot(tmp_path):
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while os.write(writing, b"full"):
            pass
    os.set_blocking(writing, True)
    with os.fdopen(reading), os.fdopen(writing) as stuck, running(tmp_path, stderr=stuck) as stage:
        set_off(stage)
        assert stage.robot.stop() == "armed"
        assert stage.robot.disarm() == "idle"
        assert stage.end() == 0


def test_without_standard_streams_it_drives_and_ends_at_rest(tmp_path):
    code = (
        "import os, sys; os.closerange(0, 3);"
        "os.execv(sys.executable, [sys.executable, '-m', 'motord', *sys.argv[1:]])"
    )
    shell = ("-c", code)
    with running(tmp_path, motord=shell) as stage:
        set_off(stage)
        assert stage.end() == 0
        assert stage.sim.truth().at_rest


@pytest.mark.parametrize("number", [signal.SIGTSTP, signal.SIGQUIT])
def test_terminal_signals_end_the_daemon_at_rest_and_do_not_suspend_it(tmp_path, number):
    with running(tmp_path) as stage:
        set_off(stage)
        assert stage.end(number) == 0
        truth = stage.sim.truth()
        assert truth.at_rest
        assert not any(joint.enabled for joint in truth.joints.values())


def test_a_source_that_reconnects_for_each_command_is_held_like_any_other(tmp_path):
    """The source sends commands during the stop, so the robot must not set off after it."""
    with running(tmp_path) as stage:
        set_off(stage)
        stage.robot.stop()
        with stage.client() as source, pytest.raises(Refused):
            assert stage.robot.disarm() == "idle"
            source.drive(0.4, 0.0, owner="again", lease_s=5.0)
        stage.robot.arm()
        with stage.client() as source:
            with pytest.raises(Refused):
                source.drive(0.4, 0.0, owner="again", lease_s=5.0)
            source.drive(0.0, 0.0, owner="again", lease_s=5.0)
            source.drive(0.4, 0.0, owner="again", lease_s=5.0)


def test_drives_without_a_stop_report_do_not_restart_after_a_pause(tmp_path):
    """While the daemon is suspended, the drives' watchdogs set the duty to 0; it stays 0."""
    with running(tmp_path, "safety.drive_watchdog_s=0.5", robot=FORWARD_ONLY) as stage:
        set_off(stage)
        stage.daemon.send_signal(signal.SIGSTOP)
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        stage.sim.reset_truth()
        stage.daemon.send_signal(signal.SIGCONT)
        stage.wait_for("fault")
        assert stage.sim.truth().moved_max_m_s < 0.01


def test_one_silent_drive_of_two_stops_both_wheels(tmp_path):
    with running(tmp_path, robot=TWO_SINGLE_DRIVES) as stage:
        set_off(stage, 0.3, 2.0)
        stage.sim.inject("drop:unit=1")
        stage.wait_for("fault")
        wait_until(lambda: stage.sim.truth().at_rest, "both wheels rest")


def test_two_robots_cannot_share_a_port(tmp_path):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        port = f"--set=line.rs485.port={json.dumps(str(tmp_path / 'rs485'))}"
        other = subprocess.Popen(
            [sys.executable, "-m", "motord", "run", str(ROBOT), port, "--set=robot.name=thief",
             "--socket", str(tmp_path / "other.sock")],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        )  # fmt: skip
        try:
            assert any("another program has it open" in line for line in other.stderr)
            set_off(stage)
        finally:
            other.terminate()
            other.communicate(timeout=DEADLINE_S)
        assert stage.state() in ("armed", "moving")


@pytest.mark.parametrize("action", ["ramp", "brake", "hold", "coast"])
def test_every_stop_action_ends_at_rest(tmp_path, action):
    every = [f"safety.{key}={action}" for key in ("on_timeout", "on_fault", "on_estop")]
    with running(tmp_path, *every) as stage:
        set_off(stage)
        stage.robot.release()
        wait_until(lambda: stage.sim.truth().at_rest, "rest after the command")
        wait_until(lambda: stage.state() in ("idle", "armed"), "the daemon's state")
        assert stage.state() == ("idle" if action == "coast" else "armed")
        set_off(stage)
        stage.robot.estop()
        wait_until(lambda: stage.sim.truth().at_rest, "rest after the emergency stop")
        if action != "hold":
            wait_until(lambda: not powered(stage), "power off")
        reset(stage)
        set_off(stage)
        stage.sim.inject("fault:unit=1,channel=1,bit=2")
        stage.wait_for("fault")
        wait_until(lambda: stage.sim.truth().at_rest, "rest after a fault")


def test_racing_requests_of_two_clients_end_disarmed(tmp_path):
    """Arm, disarm, stop, reset and an emergency stop race; afterwards nothing moves."""
    with running(tmp_path) as stage, raw_connection(stage) as one, raw_connection(stage) as two:
        stage.wait_for("idle")
        for _ in range(6):
            one.sendall(request(1, "arm") + request(2, "drive", linear_m_s=0.4, angular_rad_s=0.0))
            two.sendall(request(1, "stop") + request(2, "reset") + request(3, "disarm"))
            one.sendall(request(3, "reset") + request(4, "arm") + request(5, "estop"))
        one.sendall(request("last", "estop"))
        with one.makefile() as answers:
            next(answer for answer in answers if '"last"' in answer)
        stage.wait_for("estop")
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        wait_until(lambda: not powered(stage), "power off")


def test_a_client_that_disconnects_while_arming_leaves_nothing_moving(tmp_path):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        stage.sim.reset_truth()
        with raw_connection(stage) as peer:
            peer.sendall(request(1, "arm") + request(2, "drive", linear_m_s=0.4, angular_rad_s=0.0))
        stage.wait_for("armed")
        stage.robot.stop()
        assert stage.sim.truth().moved_max_m_s < 0.01


def test_many_clients_do_not_take_the_command_from_the_driving_one(tmp_path):
    with running(tmp_path) as stage, contextlib.ExitStack() as crowd:
        set_off(stage)
        for _ in range(100):
            crowd.enter_context(raw_connection(stage)).sendall(b"x" * 1000)
            stage.robot.drive(0.4, 0.0)
        flood = crowd.enter_context(raw_connection(stage))
        with contextlib.suppress(OSError):
            flood.sendall(b"x" * (1 << 20))
        stage.robot.drive(0.4, 0.0)
        assert stage.robot.stop() == "armed"


def test_a_deleted_socket_file_does_not_prevent_a_clean_end(tmp_path):
    with running(tmp_path) as stage:
        set_off(stage)
        stage.socket.unlink()
        assert stage.end() == 0
        assert stage.sim.truth().at_rest


@pytest.mark.parametrize("seconds", [0.0, 0.2])
def test_a_drive_that_reboots_in_motion_ends_in_a_fault_at_rest(tmp_path, seconds):
    with running(tmp_path) as stage:
        set_off(stage)
        stage.sim.inject(f"reboot:unit=1,for_s={seconds}")

        def faulted():
            with contextlib.suppress(Refused):
                stage.robot.drive(0.4, 0.0)
            return stage.state() == "fault"

        wait_until(faulted, "a latched fault")
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        reset(stage)
        assert stage.sim.truth().at_rest


def test_closing_a_client_ends_its_lease(tmp_path):
    with running(tmp_path) as stage:
        stage.wait_for("idle")
        stage.robot.arm()
        with Client(stage.socket) as source:
            wait_until(lambda: source.drive(0.4, 0.0, lease_s=5.0) and min(wheels_rad_s(stage)) > 3,
                       "the wheels turn")  # fmt: skip
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


BREAKING = """
import os, sys
from motord.__main__ import main
from motord.bus.publish.stdout import StdoutPublisher
def hand_over(publisher, line):
    if os.path.exists(sys.argv[-1] + ".break"):
        raise ValueError("this error is not expected")
StdoutPublisher._hand_over = hand_over
main()
"""


def test_an_unexpected_error_ends_the_daemon_at_rest_and_without_power(tmp_path):
    code = BREAKING.replace("sys.argv[-1]", repr(str(tmp_path / "publisher")))
    settings = (
        "publish.console.kind=stdout",
        "publish.console.rate_hz=20",
    )
    with running(tmp_path, *settings, motord=("-c", code)) as stage:
        set_off(stage)
        (tmp_path / "publisher.break").touch()
        assert stage.daemon.wait(DEADLINE_S) != 0
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
        assert not powered(stage)
        assert "this error is not expected" in stage.logged()


def test_a_signal_while_arming_ends_the_daemon_without_power(tmp_path):
    with running(tmp_path, "line.rs485.cycle_hz=2") as stage, raw_connection(stage) as peer:
        stage.wait_for("idle")
        peer.sendall(request(1, "arm"))
        wait_until(lambda: stage.robot.status()["lines"]["rs485"]["exchanges"] > 0, "an exchange")
        assert stage.end() == 0
        assert not powered(stage)


def test_a_plug_pulled_for_a_moment_while_arming_leaves_the_robot_disarmed(tmp_path):
    with running(tmp_path, "line.rs485.cycle_hz=5") as stage, raw_connection(stage) as peer:
        stage.wait_for("idle")
        peer.sendall(request(1, "arm"))
        stage.sim.pull("rs485")
        stage.sim.plug("rs485")
        with peer.makefile() as answers:
            assert "error" in json.loads(answers.readline())
        assert not powered(stage)

        def armed():
            with contextlib.suppress(Refused):
                return stage.robot.arm() == "armed"

        wait_until(armed, "armed by a new request")


def test_a_limit_changed_in_motion_never_speeds_the_robot_up(tmp_path):
    with running(tmp_path, "safety.command_timeout_s=5") as stage:
        set_off(stage)
        with pytest.raises(ClientError, match="to rest"):
            stage.robot.params_set(**{"limits.linear_deceleration_m_s2": 0.001})
        for name, value in (
            ("limits.linear_m_s", 0.001), ("limits.linear_m_s2", 100.0),
            ("limits.linear_m_s3", None), ("limits.linear_deceleration_m_s2", 100.0),
        ):  # fmt: skip
            stage.robot.params_set(**{name: value}, force=True)
            stage.robot.drive(0.4, 0.0)
        wait_until(lambda: stage.robot.drive(4.0, 0.0) and max(wheels_rad_s(stage)) < 0.3, "slow")
        stage.robot.estop()
        stage.robot.params_set(**{"limits.linear_m_s": 1.0}, force=True)
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
