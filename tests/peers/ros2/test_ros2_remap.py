# SPDX-License-Identifier: Apache-2.0
"""Topics and services under the names that `remap` gives them."""

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, called, peer, ros2_stage, settle
from tests.sim.daemon_stage import wait_until

pytest.importorskip("cyclonedds", reason="needs cyclonedds")


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    renamed = (
        "publish.ros2.remap.odom=wheels/odom",
        'input.ros2.remap={ cmd_vel = "/cmd_vel_safe", "~/arm" = "~/up" }',
    )  # fmt: skip
    with ros2_stage(tmp_path_factory.mktemp("ros2"), *renamed) as stage:
        yield stage


def test_the_robot_is_driven_and_read_by_its_remapped_names(stage):
    wait_until(lambda: called("up")["success"], "armed")
    with (
        peer("topic", f"rt{NAMESPACE}/wheels/odom", "Odometry") as ear,
        peer("drive", "rt/cmd_vel_safe", 0.3, 0.0),
    ):
        ear.find(lambda sample: sample["twist"]["twist"]["linear"]["x"] > 0.1, "a way")
    settle(stage)
