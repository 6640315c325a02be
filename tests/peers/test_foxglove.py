# SPDX-License-Identifier: Apache-2.0
"""Foxglove's server, spoken to by its protocol (foxglove/ws-protocol), message by message, and read
by another's decoder."""

import asyncio
import json
import shutil
import struct
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from rosbags.typesys import Stores, get_typestore
from tests.peers.mosquitto import free_port
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until
from websockets.asyncio.client import connect

from motord.bus.topics import TOPICS

MESSAGE_DATA = 1
MODULES = ROOT / "build/node/node_modules"
OWN_CLIENT = MODULES / "@foxglove/ws-protocol"


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    settings = ("publish.view.kind=foxglove", f"publish.view.port={port}",
                "publish.view.rate_hz=50")  # fmt: skip
    with running(tmp_path_factory.mktemp("foxglove"), *settings) as stage:
        stage.wait_for("idle")
        yield stage


async def connected(port):
    """Again until it listens."""
    while True:
        try:
            return await connect(
                f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=1 << 22
            )
        except OSError:
            await asyncio.sleep(0.05)


async def advertised(client, count):
    channels = {}
    while len(channels) < count:
        raw = await client.recv()
        if isinstance(raw, str) and (said := json.loads(raw))["op"] == "advertise":
            channels |= {channel["topic"]: channel for channel in said["channels"]}
    return channels


async def test_what_foxglove_subscribes_to_comes_and_is_what_the_daemon_says(stage, port):
    typestore = get_typestore(Stores.ROS2_JAZZY)
    async with asyncio.timeout(DEADLINE_S):
        client = await connected(port)
        try:
            channels = await advertised(client, 7)
            odom = channels["/odom"]
            assert (odom["encoding"], odom["schemaEncoding"]) == ("cdr", "ros2msg")
            assert odom["schemaName"] == "nav_msgs/msg/Odometry"
            wish = {"op": "subscribe", "subscriptions": [{"id": 5, "channelId": odom["id"]}]}
            await client.send(json.dumps(wish))
            raw = await client.recv()
            while isinstance(raw, str) or raw[0] != MESSAGE_DATA:
                raw = await client.recv()
        finally:
            await client.close()
    number, log_ns = struct.unpack_from("<IQ", raw, 1)
    message = typestore.deserialize_cdr(raw[13:], "nav_msgs/msg/Odometry")
    assert (number, message.child_frame_id) == (5, "base_link")
    stamp = message.header.stamp
    assert log_ns == stamp.sec * 10**9 + stamp.nanosec


async def test_nothing_can_be_commanded(stage, port):
    async with asyncio.timeout(DEADLINE_S):
        client = await connected(port)
        try:
            while True:
                raw = await client.recv()
                if isinstance(raw, str) and (info := json.loads(raw))["op"] == "serverInfo":
                    break
        finally:
            await client.close()
    assert not {"clientPublish", "services", "parameters"} & set(info["capabilities"])


@pytest.mark.skipif(
    not (shutil.which("node") and OWN_CLIENT.exists() and (MODULES / "ws").exists()),
    reason="apt install nodejs npm; npm install --prefix build/node @foxglove/ws-protocol ws",
)
def test_foxgloves_own_client_reads_what_there_is(stage, port):
    program = Path(__file__).with_name("foxglove_client.mjs")

    def ran():
        run = subprocess.run(
            ["node", str(program), f"ws://127.0.0.1:{port}", str(MODULES)],
            capture_output=True, timeout=2 * DEADLINE_S,
        )  # fmt: skip
        return json.loads(run.stdout) if run.stdout else None  # it may have come too early

    said = wait_until(ran, "what the client saw")
    assert said["server"]["name"] == stage.robot.status()["robot"]
    topics = {f"/{name}": topic.type_name for name, topic in TOPICS.items()}
    assert said["channels"] == topics | {"/robot_description": "std_msgs/msg/String"}
    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(
        bytes.fromhex(said["odom"]), "nav_msgs/msg/Odometry"
    )
    assert message.child_frame_id == "base_link"


async def test_whoever_begins_to_read_is_told_what_the_robot_looks_like(stage, port):
    wish = {"id": 9, "channelId": None}
    for _ in range(2):  # the second who comes, too
        async with asyncio.timeout(DEADLINE_S):
            client = await connected(port)
            try:
                channels = await advertised(client, len(TOPICS) + 1)
                wish["channelId"] = channels["/robot_description"]["id"]
                await client.send(json.dumps({"op": "subscribe", "subscriptions": [wish]}))
                raw = await client.recv()
                while isinstance(raw, str) or raw[0] != MESSAGE_DATA:
                    raw = await client.recv()
            finally:
                await client.close()
        typestore = get_typestore(Stores.ROS2_JAZZY)
        text = typestore.deserialize_cdr(raw[13:], "std_msgs/msg/String")
        joints = ET.fromstring(text.data).findall("joint[@type='continuous']")
        assert [joint.get("name") for joint in joints] == ["left", "right"]
