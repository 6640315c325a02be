# SPDX-License-Identifier: Apache-2.0
"""A lifecycle manager in another process takes the node through all of its states."""

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, called, peer, ros2_stage
from tests.sim.daemon_stage import wait_until

pytest.importorskip("cyclonedds", reason="needs cyclonedds")


def changed(number=0, label=""):
    asked = {"id": number, "label": label}
    return called("change_state", "ChangeState", transition=asked)["success"]


def state():
    return called("get_state", "GetState")["current_state"]


def test_a_lifecycle_manager_takes_the_node_through_all_its_states(tmp_path):
    events = ("topic", f"rt{NAMESPACE}/motord/transition_event", "TransitionEvent")
    with ros2_stage(tmp_path) as stage, peer(*events) as ear:

        def sent(label, goal):
            return any(
                (event["transition"]["label"], event["goal_state"]["label"]) == (label, goal)
                for event in ear.received
            )

        def configured_and_sent():
            assert changed(1)
            return sent("configure", "configuring")

        wait_until(configured_and_sent, "a log line on the configuration")
        wait_until(lambda: sent("transition_success", "inactive"), "a log line on its success")
        assert state() == {"id": 2, "label": "inactive"}
        wait_until(lambda: changed(3), "armed")
        assert state() == {"id": 3, "label": "active"}
        stage.wait_for("armed")
        assert changed(label="deactivate")
        assert changed(label="cleanup")
        assert state() == {"id": 1, "label": "unconfigured"}
        assert stage.state() == "idle"
        assert not changed(3)
        assert changed(label="configure")
        wait_until(lambda: changed(label="activate"), "armed again")
        assert changed(label="shutdown")
        assert state() == {"id": 4, "label": "finalized"}
        assert stage.state() == "idle"
        assert not changed(1)
        assert not changed(3)
        wait_until(lambda: sent("shutdown", "finalized"), "a log line on the end")
