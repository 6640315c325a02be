# SPDX-License-Identifier: Apache-2.0
"""Actions, requested by another DDS participant in another process."""

import contextlib
import json
import math
import os
import signal

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, called, caller, inputs, peer, ros2_stage
from tests.sim.daemon_stage import wait_until

pytest.importorskip("cyclonedds", reason="needs cyclonedds")
pytestmark = pytest.mark.usefixtures("settled")

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
NAMES = {"drive_distance": "DriveDistance", "rotate": "Rotate", "calibrate": "Calibrate"}
ZERO = {
    "drive_distance": dict.fromkeys(
        ("speed_m_s", "tolerance_m", "timeout_s", "direction_rad"), 0.0
    ),
    "rotate": {"speed_rad_s": 0.0, "tolerance_rad": 0.0, "timeout_s": 0.0},
    "calibrate": {"true_distance_m": 0.0, "true_angle_rad": 0.0, "timeout_s": 0.0},
}


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros2")
    precise = ("loop.rate_hz=250", "line.rs485.cycle_hz=50")  # tests measure distances
    with ros2_stage(folder, "input.person.kind=socket", *precise) as stage:
        yield stage


@contextlib.contextmanager
def goal(name, **values):
    """Start a client that sends a goal; its `accepted` is the answer."""
    asked = json.dumps(ZERO[name] | values)
    with peer("act", f"{NAMESPACE}/{name}", NAMES[name], asked) as client:
        client.accepted = client.find(lambda one: "accepted" in one, "an answer")["accepted"]
        try:
            yield client
        except AssertionError:
            if client.accepted:  # so that the goal does not disturb the next test
                client.say("cancel")
                client.find(lambda message: "canceling" in message, "an answer")
            raise


def result(client):
    message = client.find(lambda message: "status" in message, "a result")
    return message["status"], message["result"]


def wait_for_motion(stage):
    wait_until(lambda: not stage.sim.truth().at_rest, "the wheels turn")


def at_rest(stage):
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


def test_a_distance_is_driven_with_feedback_while_it_moves(armed):
    before = armed.sim.truth()
    with goal("drive_distance", distance_m=0.5) as client:
        assert client.accepted
        status, sent = result(client)
    after = armed.sim.truth()
    assert (status, sent["message"]) == (SUCCEEDED, "")
    assert sent["distance_m"] == pytest.approx(0.5, abs=0.011)
    distance_m = math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    assert distance_m == pytest.approx(0.5, abs=0.05)
    assert after.at_rest
    received = [message["feedback"] for message in client.received if "feedback" in message]
    assert len(received) > 3
    assert received[0]["distance_m"] < received[-1]["distance_m"]
    assert max(message["speed_m_s"] for message in received) > 0.05
    assert all(
        message["remaining_m"] == pytest.approx(0.5 - message["distance_m"], abs=1e-9)
        for message in received
    )


def test_negative_distances_and_angles_are_driven(armed):
    with goal("drive_distance", distance_m=-0.2) as client:
        status, sent = result(client)
    assert (status, sent["message"]) == (SUCCEEDED, "")
    assert sent["distance_m"] == pytest.approx(-0.2, abs=0.011)
    before_rad = armed.sim.truth().heading_rad
    with goal("rotate", angle_rad=-1.0) as client:
        status, sent = result(client)
    assert (status, sent["message"]) == (SUCCEEDED, "")
    assert sent["angle_rad"] == pytest.approx(-1.0, abs=0.021)
    turned_rad = math.remainder(armed.sim.truth().heading_rad - before_rad, math.tau)
    assert turned_rad == pytest.approx(-1.0, abs=0.1)


def test_a_disarmed_robot_refuses_a_goal(stage):
    before = stage.sim.truth()
    with goal("drive_distance", distance_m=0.5) as client:
        assert not client.accepted
    assert stage.state() == "idle"
    assert stage.sim.truth().x_m == before.x_m
    assert "not armed" in stage.logged()


@pytest.mark.parametrize("distance_m", [0.0, math.nan, math.inf, 1e9])
def test_a_distance_that_is_zero_not_finite_or_too_large_is_refused(armed, distance_m):
    with goal("drive_distance", distance_m=distance_m) as client:
        assert not client.accepted
    assert armed.sim.truth().at_rest


def test_a_cancelled_goal_ends_at_rest(armed):
    with goal("drive_distance", distance_m=20.0) as client:
        wait_for_motion(armed)
        client.say("cancel")
        assert client.find(lambda message: "canceling" in message, "an answer")["canceling"] == 1
        status, sent = result(client)
        assert (status, sent["message"]) == (CANCELED, "canceled")
        assert 0.0 < sent["distance_m"] < 20.0
    at_rest(armed)
    armed.wait_for("armed")


def test_a_second_goal_is_refused_while_one_is_running(armed):
    with goal("drive_distance", distance_m=20.0) as first:
        wait_for_motion(armed)
        with goal("rotate", angle_rad=1.0) as second:
            assert not second.accepted
        first.say("cancel")
        assert result(first)[0] == CANCELED


@pytest.mark.parametrize("method", ["stop", "estop", "disarm"])
def test_a_stop_ends_the_goal_at_rest(armed, method):
    with goal("drive_distance", distance_m=20.0) as client:
        wait_for_motion(armed)
        assert called(method)["success"]
        status, sent = result(client)
        assert status == ABORTED
        assert sent["message"]
    at_rest(armed)


def test_silent_drives_end_the_goal_at_rest(armed):
    with goal("drive_distance", distance_m=20.0) as client:
        wait_for_motion(armed)
        armed.sim.inject("silence:unit=1,for_s=1000")
        try:
            status, sent = result(client)
            assert status == ABORTED
            assert "stale" in sent["message"] or "fault" in sent["message"]
            at_rest(armed)
        finally:
            armed.sim.clear_faults_script()


def test_a_cmd_vel_ends_the_goal_and_is_followed(armed):
    with goal("drive_distance", distance_m=20.0) as client:
        wait_for_motion(armed)
        with peer("drive", f"rt{NAMESPACE}/cmd_vel", 0.0, 0.5):
            status, sent = result(client)
            assert (status, sent["message"]) == (ABORTED, "cmd_vel commands")
            wait_until(
                lambda: armed.robot.status()["odometry"]["angular_rad_s"] > 0.2, "the command"
            )
            with goal("rotate", angle_rad=1.0) as other:
                assert not other.accepted
    at_rest(armed)


def test_a_source_of_higher_priority_ends_the_goal(armed):
    with goal("drive_distance", distance_m=20.0) as client:
        wait_for_motion(armed)

        def taken_over():
            armed.robot.call(
                "drive", linear_m_s=0.0, angular_rad_s=0.0, priority=900, owner="person"
            )
            return any("status" in message for message in client.received)

        wait_until(taken_over, "a result")
        status, sent = result(client)
        assert (status, sent["message"]) == (ABORTED, "another source commands")
    at_rest(armed)


def bus_pid(stage):
    children = f"/proc/{stage.daemon.pid}/task/{stage.daemon.pid}/children"
    with open(children, encoding="utf-8") as file:
        pids = [int(pid) for pid in file.read().split()]
    for pid in pids:
        with contextlib.suppress(OSError), open(f"/proc/{pid}/cmdline", "rb") as file:
            if b"motord.bus" in file.read():
                return pid
    return None


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_loss_of_motord_bus_brings_the_robot_to_rest(armed, number):
    with goal("drive_distance", distance_m=20.0):
        wait_for_motion(armed)
        pid = wait_until(lambda: bus_pid(armed), "the bus process")
        caller.leave()  # it would count the killed process as a server still
        os.kill(pid, number)
        at_rest(armed)
        armed.wait_for("armed")
        x_m = armed.sim.truth().x_m
        wait_until(lambda: bus_pid(armed) not in (None, pid), "another bus process")
        wait_until(lambda: inputs(armed).get("ros2", {}).get("lease"), "a lease")
        assert armed.sim.truth().x_m == x_m


def test_a_measured_distance_gives_the_wheel_radius_and_calibrate_moves_nothing(armed):
    with goal("calibrate", quantity="wheel_radius", true_distance_m=0.55) as watching:
        assert watching.accepted
        watching.find(lambda message: "feedback" in message, "feedback")
        assert armed.sim.truth().at_rest
        with goal("drive_distance", distance_m=0.5) as client:
            assert result(client)[0] == SUCCEEDED
        status, sent = result(watching)
    assert (status, sent["message"]) == (SUCCEEDED, "")
    assert sent["factor"] == pytest.approx(0.55 / sent["distance_m"])
    assert sent["factor"] == pytest.approx(1.1, rel=0.05)


def test_an_unknown_quantity_to_measure_is_refused(stage):
    with goal("calibrate", quantity="luck", true_distance_m=1.0) as client:
        assert not client.accepted


def test_a_late_subscriber_gets_the_status_of_past_goals(armed):
    with goal("rotate", angle_rad=0.2) as client:
        assert result(client)[0] == SUCCEEDED
    topic = ("topic", f"rt{NAMESPACE}/rotate/_action/status", "GoalStatusArray", "late")
    with peer(*topic) as ear:
        sent = ear.find(lambda message: message["status_list"], "the states")
    assert sent["status_list"][-1]["status"] == SUCCEEDED
