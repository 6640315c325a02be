# SPDX-License-Identifier: Apache-2.0
"""The bridge node when daemons start, end and restart; its arguments and parameters."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.peers.ros2_rclpy.rclpy_rig import T, Trigger, drive_until, trigger, twist
from tests.peers.ros2_rclpy.rclpy_stage import (
    BEST_EFFORT,
    REAL,
    SETTINGS,
    again,
    bridge,
    bridged,
    operator,
    ros,
)
from tests.sim.daemon_stage import DEADLINE_S, ROOT, connected, ended, running, wait_until

from motord.ros2_rclpy.__main__ import options_of


@contextlib.contextmanager
def restarted(stage, *settings, number=signal.SIGKILL):
    """End the daemon by a signal, and start it again with the same files."""
    stage.end(number)
    daemon = again(stage, *settings)
    try:
        stage.daemon, stage.robot = daemon, connected(daemon, stage.socket, stage.log)
        yield
    finally:
        stage.robot.close()
        ended(daemon)


def test_after_a_restart_nothing_moves_before_it_is_armed_again(tmp_path):
    with bridged(tmp_path) as stage:
        publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)
        wait_until(lambda: trigger(stage, "arm")[0], "armed")
        drive_until(
            stage, publisher, lambda: twist(0.2), lambda: stage.state() == "moving", "moving"
        )
        with restarted(stage):
            drive_until(stage, publisher, lambda: twist(0.2), lambda: stage.state() == "idle", "up")

            def accepted():
                return stage.robot.status()["commands"]["accepted"] > 10

            drive_until(stage, publisher, lambda: twist(0.2), accepted, "its lease, by itself")
            assert stage.state() == "idle"
            assert stage.sim.truth().at_rest

            # The bridge still commands motion: it has to command rest before a program can arm.
            future = stage.operator.ask("motord/arm", Trigger)
            drive_until(stage, publisher, lambda: twist(0.2), future.done, "an answer")
            assert not future.result().success
            assert "motion" in future.result().message
            assert stage.sim.truth().at_rest

            def arms():
                future = stage.operator.ask("motord/arm", Trigger)
                drive_until(stage, publisher, lambda: twist(0.0), future.done, "an answer")
                return future.result().success

            wait_until(arms, "armed")
            drive_until(
                stage, publisher, lambda: twist(0.2), lambda: stage.state() == "moving", "moving"
            )


def test_a_daemon_with_another_robot_file_is_not_commanded(tmp_path):
    with bridged(tmp_path) as stage, restarted(stage, "base.track_m=0.5", number=signal.SIGTERM):
        assert stage.bridge.wait() == 1
        assert "restart the bridge" in stage.bridge.logged()
        assert not stage.robot.status()["leases"]


def test_it_waits_for_a_daemon_and_logs_that_once(tmp_path):
    with (
        ros(tmp_path),
        bridge(tmp_path, "--socket", tmp_path / "daemon.sock") as waiting,
        operator() as person,
    ):
        wait_until(lambda: "waiting for a daemon" in waiting.logged(), "the message")
        with running(tmp_path, *SETTINGS) as stage:
            stage.bridge, stage.operator = waiting, person
            stage.wait_for("idle")
            assert trigger(stage, "stop")[1]
            assert waiting.logged().count("waiting for a daemon") == 1


def test_its_arguments_and_parameter_files_are_checked_and_applied(tmp_path):
    """Cases: an unknown input, an unknown parameter, a parameter file, message types not built."""
    file = tmp_path / "bridge.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    input: ros\n    limits:\n      linear_m_s: 0.3\n"
    )
    with bridged(tmp_path) as stage:
        words = ("--socket", stage.socket)
        with bridge(tmp_path, *words, "--input", "nobody") as other:
            assert other.wait() == 1
            assert 'no [input.nobody] with kind = "ros2-rclpy"' in other.logged()
        with bridge(tmp_path, *words, ros_args=("-p", "speed:=1")) as other:
            assert other.wait() == 2
            assert "no parameter speed; there are: robot" in other.logged()
        without = {} if REAL else {"ROS_STANDIN_WITHOUT": "motord_msgs"}
        shipped = ROOT / "daemon/ros2/config/bridge.yaml"
        files = ("--params-file", shipped, "--params-file", file)
        ros_args = (*files, "-r", "__node:=second")
        with bridge(tmp_path, *words, ros_args=ros_args, environ=without) as other:
            wait_until(
                lambda: stage.robot.params_get("limits.linear_m_s")["limits.linear_m_s"] == 0.3,
                f"the limit of the file\n{other.logged()}",
            )
            if not REAL:
                wait_until(lambda: "no motord_msgs in this ROS 2" in other.logged(), "the message")


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"speed": 1.0}, "no parameter speed"),
        ({"robot": 1}, "parameter robot: must be a string, not 1"),
        ({"stamped": "yes"}, "parameter stamped: true or false"),
        ({"limits.linear_m_s": "fast"}, "a number, not 'fast'"),
        ({"limits.linear_m_s": float("nan")}, "a number, not nan"),
        ({"limits.linear_m_s": True}, "a number, not True"),
    ],
)
def test_an_unknown_or_wrong_parameter_is_named(parameters, why):
    with pytest.raises(ValueError, match=why):
        options_of(parameters)


def test_parameters_of_the_node_are_requests():
    given = {"use_sim_time": False, "robot": "", "socket": "/run/r2.sock", "stamped": False}
    options = options_of(given | {"limits.linear_m_s": 1})
    assert (options.robot, options.socket, options.input) == (None, Path("/run/r2.sock"), "ros")
    assert not options.stamped
    assert options.limits == {"limits.linear_m_s": 1.0}


def test_it_needs_only_the_standard_library():
    """The bridge runs in the Python of ROS 2, which has no dependencies of motord."""
    path = os.pathsep.join(str(ROOT / folder) for folder in ("daemon", "hal"))
    run = subprocess.run(
        [sys.executable, "-S", "-c", "import motord.ros2_rclpy.bridge, motord.ros2_rclpy.__main__"],
        env={**os.environ, "PYTHONPATH": path}, cwd="/", capture_output=True, timeout=DEADLINE_S,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr.decode()


@pytest.mark.skipif(REAL, reason="ROS 2 is here")
def test_without_ros_it_exits_with_the_reason():
    run = subprocess.run(
        [sys.executable, "-m", "motord.ros2_rclpy"], capture_output=True, timeout=DEADLINE_S
    )
    assert run.returncode == 2
    assert b"no ROS 2 in this Python" in run.stderr
