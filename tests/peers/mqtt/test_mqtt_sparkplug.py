# SPDX-License-Identifier: Apache-2.0
"""The Sparkplug format of MQTT on Eclipse Mosquitto: births, deaths, data and commands."""

import json
import os
import signal

import cbor2
import pytest
from tests.peers.light import LIGHT
from tests.peers.mqtt.mosquitto import needs_mosquitto, stamp
from tests.peers.tokens import TOKEN, token_file
from tests.sim.daemon_stage import DEADLINE_S, release_sources, running, wait_until

pytestmark = needs_mosquitto


@pytest.fixture(scope="module")
def stage(tmp_path_factory, peer):
    folder = tmp_path_factory.mktemp("sparkplug")
    common = ("kind=mqtt", f"port={peer.port}", "topic_scheme=sparkplug", "group=site")
    settings = [f"{table}.fleet.{setting}" for table in ("publish", "input") for setting in common]
    settings += [
        f"publish.short.{setting}" for setting in (*common, "encoding=cbor", 'topics=["tf"]')
    ]
    more = (
        "publish.short.topic_prefix=cbor", "publish.fleet.rate_hz=20",
        f"input.fleet.token_file={token_file(folder)}", "input.fleet.lease_s=1.0",
        "safety.command_timeout_s=1.0", *LIGHT,
    )  # fmt: skip
    with running(folder, *settings, *more) as stage:
        stage.wait_for("idle")
        wait_until(lambda: ready(stage), "a lease")
        yield stage


def ready(stage):
    inputs = (stage.robot.status()["bus"] or {}).get("inputs") or {}
    return inputs.get("fleet", {}).get("lease")


def name(stage):
    return stage.robot.status()["robot"]


def retained(peer, topic):
    return json.loads(peer.get(topic, "--retained-only"))


def test_a_late_subscriber_gets_the_birth_and_each_topic(stage, peer):
    birth = retained(peer, f"spBv1.0/site/NBIRTH/{name(stage)}")
    assert birth["joints"] == ["left", "right"]
    assert birth["bdSeq"] <= birth["timestamp"]
    topic = retained(peer, f"spBv1.0/site/DBIRTH/{name(stage)}/odom")
    about = {"type": "nav_msgs/msg/Odometry", "rate_hz": 20.0}
    assert {key: topic[key] for key in about} == about == birth["topics"]["odom"]


def test_data_carry_the_topics_messages(stage, peer):
    message = json.loads(peer.get(f"spBv1.0/site/DDATA/{name(stage)}/odom"))
    assert message["child_frame_id"] == "base_link"


def test_namespace_and_encoding_can_be_set(stage, peer):
    birth = cbor2.loads(peer.get(f"cbor/site/NBIRTH/{name(stage)}", "-N", "--retained-only"))
    assert set(birth["topics"]) == {"tf"}
    message = cbor2.loads(peer.get(f"cbor/site/DDATA/{name(stage)}/tf", "-N"))
    assert message["transforms"][0]["child_frame_id"] == "base_link"


def test_dcmd_carries_commands_and_ncmd_carries_calls(stage, peer):
    node = f"spBv1.0/site/NCMD/{name(stage)}"
    device = f"spBv1.0/site/DCMD/{name(stage)}/cmd_vel"

    def armed():
        method = {"fault": "reset", "idle": "arm"}.get(stage.state())
        if method is not None:
            peer.pub(node, {"token": TOKEN, "method": method, "id": 1})
        return stage.state() == "armed"

    def moving():
        if stage.state() not in ("armed", "moving"):
            wait_until(armed, "armed")
            release_sources(stage)
        twist = {"linear": {"x": 0.2}, "angular": {"z": 0.0}}
        peer.pub(device, {"token": TOKEN, "header": stamp(), "twist": twist})
        return stage.state() == "moving"

    wait_until(moving, "the robot moves", 2 * DEADLINE_S)
    stage.wait_for("armed", "fault")  # "fault": latched by a busy machine


def test_a_killed_process_leaves_the_death_of_its_last_birth(stage, peer):
    """Birth and death are retained: a client that connects later sees that the process is gone."""
    born = retained(peer, f"spBv1.0/site/NBIRTH/{name(stage)}")["bdSeq"]
    pid = stage.robot.status()["bus"]["pid"]
    os.kill(pid, signal.SIGKILL)
    assert json.loads(peer.get(f"spBv1.0/site/NDEATH/{name(stage)}")) == {"bdSeq": born}
    birth = f"spBv1.0/site/NBIRTH/{name(stage)}"
    wait_until(lambda: retained(peer, birth)["bdSeq"] > born, "another birth")
    assert retained(peer, f"spBv1.0/site/NDEATH/{name(stage)}") == {"bdSeq": born}
    wait_until(lambda: ready(stage) and stage.robot.status()["bus"]["pid"] != pid, "a lease")
