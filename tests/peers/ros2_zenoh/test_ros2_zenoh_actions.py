# SPDX-License-Identifier: Apache-2.0
"""ROS 2 actions over a real Zenoh router, requested by a session with another encoder."""

import threading

import numpy as np
import pytest
import rosbags.typesys as rosbags
from tests.peers.ros2_zenoh.zenoh_rig import ask, attached
from tests.peers.ros2_zenoh.zenoh_robot_rig import armed, robot
from tests.sim.daemon_stage import wait_until

from motord.bus.messages.table import type_hash

__all__ = ["robot"]  # a fixture: this file has a robot of its own

ACTION = "motord_msgs/action/DriveDistance"
UUID = "peer/msg/Uuid"
TYPES = {
    "peer/msg/Goal": (
        "float64 distance_m\nfloat64 speed_m_s\nfloat64 tolerance_m\nfloat64 timeout_s\n"
        "float64 direction_rad\n"
    ),
    "peer/msg/Result": (
        "float64 distance_m\nfloat64 turned_rad\nfloat64 duration_s\nstring message\n"
    ),
    "peer/msg/Feedback": "float64 distance_m\nfloat64 remaining_m\nfloat64 speed_m_s\n",
    UUID: "uint8[16] uuid\n",
    "peer/msg/Info": "peer/Uuid goal_id\nbuiltin_interfaces/Time stamp\n",
    "peer/msg/Send": "peer/Uuid goal_id\npeer/Goal goal\n",
    "peer/msg/Sent": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    "peer/msg/Ask": "peer/Uuid goal_id\n",
    "peer/msg/Told": "int8 status\npeer/Result result\n",
    "peer/msg/Cancel": "peer/Info goal_info\n",
    "peer/msg/Canceling": "int8 return_code\npeer/Info[] goals_canceling\n",
    "peer/msg/Message": "peer/Uuid goal_id\npeer/Feedback feedback\n",
}
SUCCEEDED, CANCELED = 4, 5


def made_store():
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    types = {}
    for name, text in TYPES.items():
        types |= rosbags.get_types_from_msg(text, name)
    store.register(types)
    return store


STORE = made_store()


def key(part, kind):
    package, group, short = kind.split("/")
    named = f"{package}::{group}::dds_::{short}_"
    return f"5/r2/drive_distance/_action/{part}/{named}/{type_hash(kind)}"


class Client:
    """Client of one goal."""

    def __init__(self, session, number):
        self.session = session
        self.goal_id = STORE.types[UUID](uuid=np.full(16, number, np.uint8))
        self.feedback = []
        self._kept = session.declare_subscriber(
            key("feedback", f"{ACTION}_FeedbackMessage"), self._take
        )

    def _take(self, sample):
        message = STORE.deserialize_cdr(sample.payload.to_bytes(), "peer/msg/Message")
        self.feedback.append(message.feedback)

    def _asked(self, part, kind, ending, **values):
        request, response = ending
        message = STORE.types[f"peer/msg/{request}"](**values)
        payload = bytes(STORE.serialize_cdr(message, f"peer/msg/{request}"))
        (reply,) = ask(self.session, key(part, kind), payload=payload, attachment=attached())
        return STORE.deserialize_cdr(reply.ok.payload.to_bytes(), f"peer/msg/{response}")

    def send(self, distance_m):
        goal = STORE.types["peer/msg/Goal"](
            distance_m=distance_m,
            speed_m_s=0.0,
            tolerance_m=0.0,
            timeout_s=0.0,
            direction_rad=0.0,
        )
        return self._asked(
            "send_goal", f"{ACTION}_SendGoal", ("Send", "Sent"), goal_id=self.goal_id, goal=goal
        ).accepted

    def result(self):
        return self._asked(
            "get_result", f"{ACTION}_GetResult", ("Ask", "Told"), goal_id=self.goal_id
        )

    def cancel(self):
        stamp = STORE.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
        info = STORE.types["peer/msg/Info"](goal_id=self.goal_id, stamp=stamp)
        return self._asked(
            "cancel_goal", "action_msgs/srv/CancelGoal", ("Cancel", "Canceling"), goal_info=info
        )


def test_a_distance_is_driven_with_feedback_and_a_result(robot):
    stage, driver = robot
    with armed(stage, driver):
        client = Client(driver.session, 1)
        assert client.send(0.3)
        sent = client.result()
    assert (sent.status, sent.result.message) == (SUCCEEDED, "")
    assert sent.result.distance_m == pytest.approx(0.3, abs=0.011)
    assert client.feedback[-1].distance_m > client.feedback[0].distance_m


def test_a_goal_is_cancelled_while_a_client_waits_for_its_result(robot):
    stage, driver = robot
    with armed(stage, driver):
        client, results = Client(driver.session, 2), []
        assert client.send(20.0)
        waiting = threading.Thread(target=lambda: results.append(client.result()))
        waiting.start()
        wait_until(lambda: not stage.sim.truth().at_rest, "the wheels turn")
        answer = client.cancel()
        assert (answer.return_code, len(answer.goals_canceling)) == (0, 1)
        waiting.join()
        assert results[0].status == CANCELED
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


def test_a_disarmed_robot_refuses_a_goal(robot):
    stage, driver = robot
    stage.wait_for("idle")
    assert not Client(driver.session, 3).send(0.3)
    assert stage.state() == "idle"


def test_an_unknown_goal_has_no_result_and_is_not_cancelled(robot):
    _, driver = robot
    client = Client(driver.session, 4)
    assert client.result().status == 0
    assert client.cancel().return_code == 2
