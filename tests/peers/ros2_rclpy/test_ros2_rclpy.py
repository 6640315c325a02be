# SPDX-License-Identifier: Apache-2.0
"""motord-bus with nodes of a real rclpy on rmw_fastrtps_cpp, from wheels of ROS 2."""

import contextlib
import json
from pathlib import Path

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, peer, ros2_stage, settle
from tests.peers.ros2_rclpy.rclpy_real import DISTRIBUTIONS, environ_of, made
from tests.sim.daemon_stage import UNHURRIED, armed, wait_until

from motord.bus.messages.table import TYPES, type_hash
from motord.client import ClientError

pytest.importorskip("cyclonedds", reason="needs cyclonedds")

PEER = Path(__file__).with_name("rclpy_peer.py")
WAIT_S = 2.0
pytestmark = pytest.mark.skipif(
    not any(map(made, DISTRIBUTIONS)), reason="no rclpy: make build/ros-kilted/made"
)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with ros2_stage(tmp_path_factory.mktemp("ros2"), *UNHURRIED) as stage:
        yield stage


@pytest.fixture(params=DISTRIBUTIONS)
def node(request, tmp_path):
    """Return a function that starts a node (rclpy_peer.py) of that distribution."""
    folder = made(request.param)
    if folder is None:
        pytest.skip(f"make build/ros-{request.param}/made")
    environ = environ_of(folder) | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_LOG_DIR": tmp_path,
        "PYTHONPATH": "",
    }
    settings = [f"{key}={value}" for key, value in environ.items()]
    program = ("env", *settings, str(folder / "bin/python"), str(PEER))
    return lambda *words: peer(*words, program=program)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_each_type_has_the_hash_that_ros_2_computes(distribution):
    folder = made(distribution)
    if folder is None:
        pytest.skip(f"make build/ros-{distribution}/made")
    ours, theirs = {}, {}
    for file in folder.glob("share/*/*/*.json"):
        for each in json.loads(file.read_text("utf-8")).get("type_hashes", ()):
            if each["type_name"] in TYPES:
                theirs[each["type_name"]] = each["hash_string"]
                ours[each["type_name"]] = type_hash(each["type_name"])
    assert {name.split("/")[0] for name in ours} >= {"motord_msgs", "nav_msgs", "sensor_msgs"}
    assert ours == theirs


def test_a_node_reads_odometry_and_drives_the_robot(node, stage):
    def attempt():
        """Arm, and return whether the robot is armed; reset a fault of a busy machine."""
        state = stage.state()
        if state in ("fault", "estop"):
            stage.robot.reset()
        elif state == "idle":
            stage.robot.arm()
        return state == "armed"

    wait_until(attempt, "armed")
    with node("drive", NAMESPACE, 0.3, 0.0) as driver:
        driver.find(lambda sent: sent.get("description") == "<robot name=", "the description")
        moved = driver.find(
            lambda sent: sent.get("linear_m_s", 0.0) > 0.05 and sent["x_m"] > 0.05, "a distance"
        )
    assert moved["frames"] == ["r2/odom", "r2/base_link"]
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    settle(stage)


def test_a_node_reads_one_of_motords_own_messages(node, stage):
    with node("watch", NAMESPACE) as watcher:
        status = watcher.find(lambda sent: sent.get("state") == "idle", "its state")
    assert status["setpoint_rad_s"] == {"left": 0.0, "right": 0.0}


def test_the_estop_topic_stops_the_robot_and_names_the_node(node, stage):
    reason = "input.ros2: by /watcher: 'a person is too close' (process "
    with node("say", f"{NAMESPACE}/motord/estop", "a person is too close", "watcher"):
        stage.wait_for("estop")
        wait_until(
            lambda: any(why.startswith(reason) for why in stage.robot.status()["why"]), "the reason"
        )
    settle(stage)


def test_the_stop_topic_holds_a_source_that_drives(node, stage):
    settle(stage)
    with armed(stage), stage.client() as robot:

        def held():
            with contextlib.suppress(ClientError):
                robot.drive(0.1, 0.0)
            return stage.robot.status()["held"]

        robot.drive(0.0, 0.0)
        with node("say", f"{NAMESPACE}/motord/stop", "a person is too close", "watcher"):
            wait_until(held, "the stop")
    settle(stage)


def test_wait_for_service_ends_at_its_time_out_and_the_client_is_named(node, stage, request):
    name = f"panel_{request.node.callspec.params['node']}"
    with node("wait", f"{NAMESPACE}/motord/arm", name, WAIT_S) as client:
        waited = client.find(lambda _: True, "an end of wait_for_service")
        assert waited == {"available": False}
        listed = client.find(lambda sent: "listed" in sent, "the service in the graph")
        assert listed == {"listed": True, "available": False}
        line = f"answers: /{name} (Fast DDS) calls {NAMESPACE}/motord/arm: run"
        wait_until(lambda: line in stage.logged(), "a log line on its middleware")
    assert "deserialization" not in stage.logged()
    assert stage.state() == "idle"
