# SPDX-License-Identifier: Apache-2.0
"""The graph of Humble, read by a participant with Humble's message definition."""

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, peer, ros2_stage

pytest.importorskip("cyclonedds", reason="needs cyclonedds")


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    humble = (f"{table}.ros2.distribution=humble" for table in ("publish", "input"))
    with ros2_stage(tmp_path_factory.mktemp("ros2"), *humble) as stage:
        yield stage


def test_humble_lists_the_node_with_names_of_24_bytes(stage):
    with (
        peer("topic", "ros_discovery_info", "HumbleEntities", "late") as ear,
        peer("endpoints") as eye,
    ):
        seen = ear.find(lambda _: True, "the graph")
        odom = eye.find(lambda found: found["topic"] == f"rt{NAMESPACE}/odom", "odom")
    (node,) = seen["node_entities_info_seq"]
    assert (node["node_namespace"], node["node_name"]) == (NAMESPACE, "motord")
    gids = [gid["data"] for gid in (*node["writer_gid_seq"], *node["reader_gid_seq"])]
    assert len(gids) > 15
    assert all(len(gid) == 24 and gid[16:] == [0] * 8 for gid in gids)
    assert odom["guid"] in [gid[:16] for gid in gids]
