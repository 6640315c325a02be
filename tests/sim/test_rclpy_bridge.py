# SPDX-License-Identifier: Apache-2.0
"""The bridge for machines with ROS 2, as far as it goes without: all of it but rclpy's own part,
against a daemon."""

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import time

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until

from motord.ros2_rclpy.bridge import TRIGGERS, Bridge, NotTaken

LEASE_S = 1.0
SETTINGS = (
    "input.ros.kind=ros2-rclpy", "input.ros.trust_network=true", f"input.ros.lease_s={LEASE_S}",
    "input.ros.priority=60", f"safety.command_timeout_s={LEASE_S}",
    "joint.left.tries=10", "joint.right.tries=10",
)  # fmt: skip
DRIVER = """
import sys, time
from pathlib import Path
from motord.ros2_rclpy.bridge import Bridge
bridge = Bridge(Path(sys.argv[1]), "ros", stamped=False)
while True:
    bridge.drive(0.2, 0.0)
    time.sleep(0.05)
"""


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("rclpy"), *SETTINGS) as stage:
        stage.wait_for("idle")
        yield stage


@pytest.fixture
def bridge(stage):
    made = Bridge(stage.socket, "ros")
    yield made
    made.close()
    wait_until(lambda: not stage.robot.status()["leases"], "the lease's end")


def now():
    sec, nanosec = divmod(time.time_ns(), 10**9)
    return sec, nanosec


def armed(stage, bridge):
    def attempt():
        method = {"fault": "reset", "estop": "reset", "idle": "arm"}.get(stage.state())
        if method is not None:
            bridge.call(method)
        return stage.state() == "armed"

    wait_until(attempt, f"armed\n{stage.said()}")


def test_services_answer_with_the_state_or_with_why_not(stage, bridge):
    armed(stage, bridge)
    assert bridge.call("estop") == (True, "estop")
    done, why = bridge.call("arm")
    assert not done
    assert "emergency stop" in why
    assert bridge.call("reset") == (True, "idle")
    assert bridge.call("reset_odometry") == (True, "idle")


def test_a_full_socket_ends_no_lease(stage, bridge):
    bridge.drive(0.0, 0.0, now())
    number = wait_until(lambda: stage.robot.status()["leases"], "the lease")[0]["number"]
    os.kill(stage.daemon.pid, signal.SIGSTOP)
    try:
        with pytest.raises(NotTaken, match="is full"):
            while True:
                bridge.drive(0.0, 0.0, now())
    finally:
        os.kill(stage.daemon.pid, signal.SIGCONT)

    def goes_on():
        with contextlib.suppress(NotTaken):
            bridge.drive(0.0, 0.0, now())
        return [lease["number"] for lease in stage.robot.status()["leases"]] == [number]

    wait_until(goes_on, "the same lease")


def test_every_service_is_a_method_of_the_daemon(stage, bridge):
    for method in TRIGGERS:
        assert "unknown" not in bridge.call(method)[1].lower()
    bridge.call("reset")


def test_commands_move_the_robot_under_the_inputs_own_lease(stage, bridge):
    armed(stage, bridge)

    def drives():
        bridge.drive(0.2, 0.0, now())
        return stage.state() == "moving"

    wait_until(drives, "moving")
    (lease,) = stage.robot.status()["leases"]
    assert (lease["owner"], lease["priority"]) == ("ros", 60)
    stage.wait_for("armed", "fault")


@pytest.mark.parametrize(
    ("stamp", "why"),
    [(None, "no stamp"), ((0, 0), "zero"), ((2**31 - 1, 0), "future")],
)
def test_a_command_whose_age_cannot_be_known_is_not_passed_on(stage, bridge, stamp, why):
    before = stage.robot.status()["commands"]
    with pytest.raises(NotTaken, match=why):
        bridge.drive(0.2, 0.0, stamp)
    assert stage.robot.status()["commands"] == before


def test_a_command_that_waited_somewhere_is_refused_by_the_loop(stage, bridge):
    armed(stage, bridge)
    before = stage.robot.status()["commands"]["refused"]["age"]
    sec, nanosec = now()
    bridge.drive(0.2, 0.0, (sec - 30, nanosec))
    bridge.drive(0.2, 0.0, (1, 0))  # 1970
    wait_until(
        lambda: stage.robot.status()["commands"]["refused"]["age"] == before + 2, "two refusals"
    )
    assert stage.state() != "moving"


def test_a_bridge_that_is_killed_loses_its_lease(stage, bridge):
    armed(stage, bridge)
    with subprocess.Popen([sys.executable, "-c", DRIVER, str(stage.socket)], cwd=ROOT) as process:
        try:
            stage.wait_for("moving")
        finally:
            process.send_signal(signal.SIGKILL)
    wait_until(lambda: not stage.robot.status()["leases"], "nobody in command")
    stage.wait_for("armed", "fault")


def test_a_command_without_a_stamp_that_may_have_waited_moves_nothing(stage):
    bridge = Bridge(stage.socket, "ros", stamped=False)

    def accepted():
        return stage.robot.status()["commands"]["accepted"]

    try:
        for _ in range(2):
            before, since_s = accepted(), time.monotonic()
            bridge.drive(0.0, 0.0)  # nobody has commanded for long: who knows since when it waits
            assert accepted() == before

            def taken(before=before):
                bridge.drive(0.0, 0.0)
                return accepted() > before

            wait_until(taken, "those that follow it for long enough are taken")
            assert time.monotonic() - since_s >= LEASE_S
            over_s = time.monotonic() + 1.1 * LEASE_S
            wait_until(lambda over_s=over_s: time.monotonic() > over_s, "a silence")
    finally:
        bridge.close()


def test_it_is_no_bus_of_the_second_process(stage):
    assert stage.robot.status()["bus"] is None


def test_without_a_daemon_a_command_says_so_and_the_next_daemon_is_found(tmp_path):
    path = tmp_path / "daemon.sock"
    bridge = Bridge(path, "ros", stamped=False)
    with pytest.raises(NotTaken, match="no lease"):
        bridge.drive(0.0, 0.0)
    done, why = bridge.call("arm")
    assert not done
    assert "daemon.sock" in why
    with running(tmp_path, *SETTINGS) as stage:
        stage.wait_for("idle")

        def taken():
            try:
                bridge.drive(0.0, 0.0)
            except NotTaken:
                return False
            return True

        wait_until(taken, "a lease")
        assert stage.end() == 0
        wait_until(lambda: not taken(), "the daemon's end")
    bridge.close()


def test_it_needs_the_standard_library_alone():
    """ROS brings its own Python, without what motord needs elsewhere."""
    run = subprocess.run(
        [sys.executable, "-S", "-c", "import motord.ros2_rclpy.bridge, motord.ros2_rclpy.__main__"],
        env={**os.environ, "PYTHONPATH": str(ROOT / "daemon")}, cwd="/", capture_output=True,
        timeout=DEADLINE_S,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr.decode()


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="ROS 2 is here")
def test_without_ros_it_says_so():
    run = subprocess.run(
        [sys.executable, "-m", "motord.ros2_rclpy"], capture_output=True, timeout=DEADLINE_S
    )
    assert run.returncode == 2
    assert b"no ROS 2 in this Python" in run.stderr
