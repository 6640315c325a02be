# SPDX-License-Identifier: Apache-2.0
"""The bridge node with clients of a real rclpy, each in a process of its own."""

import json
import os
from pathlib import Path

import pytest
from tests.peers.ros2.life_steps import STEPS, never_old
from tests.peers.ros2.ros2_stage import Peer
from tests.peers.ros2_rclpy.rclpy_real import ENVIRON, PYTHON, REAL
from tests.peers.ros2_rclpy.rclpy_rig import Trigger
from tests.peers.ros2_rclpy.rclpy_stage import NAMESPACE, bridged
from tests.sim.daemon_stage import becomes_idle, wait_until

pytestmark = pytest.mark.skipif(not REAL, reason="no rclpy: make build/ros-kilted/made")

PEER = Path(__file__).with_name("rclpy_peer.py")
GOAL_LEASE_S = 5.0
FAR_M = 1000
ROUNDS = 2


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    settings = (f"input.ros.goal_lease_s={GOAL_LEASE_S}", *never_old("ros"))
    with bridged(tmp_path_factory.mktemp("rclpy"), *settings) as stage:
        yield stage


def client(*words):
    environ = {**ENVIRON, "PYTHONPATH": ""}
    program = ["env", *(f"{key}={value}" for key, value in environ.items()), PYTHON, str(PEER)]
    return Peer([*program, os.environ["ROS_DOMAIN_ID"], *map(str, words)], json.loads)


def test_the_emergency_stop_as_a_service_is_answered_to_a_fresh_process(stage):
    becomes_idle(stage)
    peer = client("call", f"{NAMESPACE}/motord/estop")
    try:
        answer = peer.find(lambda sent: "success" in sent, "an answer")
    finally:
        peer.close()
    assert answer["success"]
    assert stage.state() == "estop"
    becomes_idle(stage)


def test_each_transition_goes_by_what_the_answer_before_it_left(stage):
    becomes_idle(stage)
    peer = client("walk", NAMESPACE, json.dumps(STEPS), ROUNDS)
    try:
        right = peer.find(lambda sent: "right" in sent, "the end")["right"]
    finally:
        peer.close()
    assert set(right.values()) == {ROUNDS}, peer.received
    assert len(right) == len(STEPS)
    becomes_idle(stage)


def test_the_robot_stops_when_the_client_of_a_goal_is_killed(stage):
    becomes_idle(stage)
    wait_until(lambda: stage.operator.call("motord/arm", Trigger).success, "armed")
    peer = client("goal", NAMESPACE, FAR_M)
    try:
        assert peer.find(lambda sent: "accepted" in sent, "an answer")["accepted"]
        begin_m = stage.sim.truth().x_m
        wait_until(lambda: stage.sim.truth().x_m > begin_m + GOAL_LEASE_S, "it goes on")
    finally:
        peer.close()
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    wait_until(lambda: stage.state() == "armed", "armed, at rest")
