# SPDX-License-Identifier: Apache-2.0
"""ROS 2 topics exchanged with another DDS implementation: eProsima Fast DDS, in C++."""

import shutil
import subprocess
from pathlib import Path

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, called, peer, ros2_stage, settle
from tests.sim.daemon_stage import release_sources, wait_until

pytest.importorskip("cyclonedds", reason="needs cyclonedds")

SOURCE = Path(__file__).with_name("fastdds_peer.cpp")
HEADERS = Path("/usr/include/fastrtps")
BUILD_WITHIN_S = 300.0
COMPILER = shutil.which("c++")

pytestmark = [
    pytest.mark.skipif(
        not (COMPILER and HEADERS.is_dir()), reason="apt install g++ libfastrtps-dev libfastcdr-dev"
    ),
    pytest.mark.timeout(BUILD_WITHIN_S + 120.0),
]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    made = tmp_path_factory.mktemp("fastdds") / "fastdds_peer"
    command = [COMPILER, "-std=c++17", "-Wall", str(SOURCE), "-o", str(made)]
    libraries = ["-lfastrtps", "-lfastcdr"]
    subprocess.run([*command, *libraries], check=True, timeout=BUILD_WITHIN_S)
    return made


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with ros2_stage(tmp_path_factory.mktemp("ros2")) as stage:
        yield stage


def decode(line):
    x, v, frame, child = line.split()
    return {"x_m": float(x), "linear_m_s": float(v), "frames": (frame, child)}


@pytest.fixture
def fast(program):
    return lambda *words: peer(*words, program=(str(program),), decode=decode)


def test_fast_dds_turns_the_wheels(fast, stage):
    def speeds():
        joints = stage.sim.truth().joints
        return [joints[name].velocity_rad_s for name in ("left", "right")]

    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    with fast("joints", f"rt{NAMESPACE}/joint_commands", 1.0, 2.0):
        wait_until(lambda: speeds() == pytest.approx([1.0, 2.0], abs=0.2), "the wheels' speeds")
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    settle(stage)


def test_fast_dds_reads_odometry_and_drives_the_robot(fast, stage):
    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    with (
        fast("odom", f"rt{NAMESPACE}/odom") as ear,
        fast("drive", f"rt{NAMESPACE}/cmd_vel", 0.3, 0.0),
    ):
        moved = ear.find(lambda sent: sent["x_m"] > 0.1 and sent["linear_m_s"] > 0.0, "a distance")
    assert moved["frames"] == ("r2/odom", "r2/base_link")
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    settle(stage)


def test_a_writer_of_another_type_is_named(fast, stage):
    with fast("joints", f"rt{NAMESPACE}/cmd_vel", 1.0, 2.0):
        row = f"rt{NAMESPACE}/cmd_vel: a writer of sensor_msgs/msg/JointState is not received"
        wait_until(lambda: row in stage.logged(), "a log line on its type")


def test_the_estop_topic_stops_the_robot_and_names_the_node(fast, stage):
    """The topic serves clients that cannot call a service (the test of availability below)."""
    reason = "input.ros2: by /watcher: 'a person is too close' (process "
    with fast("say", f"rt{NAMESPACE}/motord/estop", "a person is too close", "watcher"):
        stage.wait_for("estop")
        wait_until(
            lambda: any(why.startswith(reason) for why in stage.robot.status()["why"]), "the reason"
        )
    settle(stage)


def test_a_late_subscriber_gets_the_robot_description(program, stage):
    topic = f"rt{NAMESPACE}/robot_description"
    with peer("text", topic, program=(str(program),), decode=str.rstrip) as ear:
        assert ear.find(lambda _: True, "the description") == "<robot name="


def counts(line):
    readers, writers = map(int, line.split())
    return {"readers": readers, "writers": writers}


def test_a_service_is_not_available_to_a_client_that_could_not_read_its_answer(program, stage):
    """rmw_fastrtps takes a service for available if it has as many writers of replies as readers of
    requests (rmw_service_server_is_available.cpp)."""
    settle(stage)
    client = ("ask", f"{NAMESPACE}/motord/arm", "panel")
    with peer(*client, program=(str(program),), decode=counts) as asking:
        asking.find(lambda met: met == {"readers": 1, "writers": 2}, "both sides of the service")
        line = f"answers: /panel (Fast DDS) calls {NAMESPACE}/motord/arm: run"
        wait_until(lambda: line in stage.logged(), "a log line on its middleware")
        assert called("disarm")["success"]  # other middleware has no such rule
    assert stage.logged().count("/panel (Fast DDS)") == 1
    assert "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp" in stage.logged()
    assert "deserialization" not in stage.logged()  # the library would log it for each request
    assert stage.state() == "idle"
