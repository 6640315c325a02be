# SPDX-License-Identifier: Apache-2.0
"""The Foxglove server, tested message by message by its protocol (foxglove/ws-protocol) and with
another project's decoder."""

import asyncio
import json
import shutil
import struct
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from rosbags.typesys import Stores, get_typestore
from tests.peers.foxglove.foxglove_wire import MESSAGE_DATA, wired
from tests.peers.light import LIGHT
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until

from motord.bus.messages.topics import TOPICS

MODULES = ROOT / "build/node/node_modules"
OWN_CLIENT = MODULES / "@foxglove/ws-protocol"
OFFERED = {name: topic for name, topic in TOPICS.items() if name != "imu"}
"""Topics that the server offers: all but `imu`, as the demonstration robot has no IMU."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    settings = ("publish.view.kind=foxglove", f"publish.view.port={port}",
                "publish.view.rate_hz=50", *LIGHT)  # fmt: skip
    with running(tmp_path_factory.mktemp("foxglove"), *settings) as stage:
        stage.wait_for("idle")
        yield stage


async def test_subscribed_topics_arrive_and_match_the_daemons_status(stage, port):
    typestore = get_typestore(Stores.ROS2_JAZZY)
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        odom = (await client.advertised(7))["/odom"]
        assert (odom["encoding"], odom["schemaEncoding"]) == ("cdr", "ros2msg")
        assert odom["schemaName"] == "nav_msgs/msg/Odometry"
        await client.send("subscribe", subscriptions=[{"id": 5, "channelId": odom["id"]}])
        raw = await client.received(MESSAGE_DATA)
    number, log_ns = struct.unpack_from("<IQ", raw, 1)
    message = typestore.deserialize_cdr(raw[13:], "nav_msgs/msg/Odometry")
    assert (number, message.child_frame_id) == (5, "base_link")
    stamp = message.header.stamp
    assert log_ns == stamp.sec * 10**9 + stamp.nanosec


async def test_nothing_can_be_commanded(stage, port):
    async with asyncio.timeout(DEADLINE_S), wired(port) as client:
        info = await client.received("serverInfo")
    assert not {"clientPublish", "services", "parameters"} & set(info["capabilities"])


@pytest.mark.skipif(
    not (shutil.which("node") and OWN_CLIENT.exists() and (MODULES / "ws").exists()),
    reason="apt install nodejs npm; npm install --prefix build/node @foxglove/ws-protocol ws",
)
def test_foxgloves_own_client_reads_every_channel(stage, port):
    program = Path(__file__).with_name("foxglove_client.mjs")

    def ran():
        run = subprocess.run(
            ["node", str(program), f"ws://127.0.0.1:{port}", str(MODULES)],
            capture_output=True, timeout=2 * DEADLINE_S,
        )  # fmt: skip
        return json.loads(run.stdout) if run.stdout else None  # None: the server did not listen yet

    found = wait_until(ran, "what the client saw")
    assert found["server"]["name"] == stage.robot.status()["robot"]
    topics = {f"/{name}": topic.type_name for name, topic in OFFERED.items()}
    assert found["channels"] == topics | {"/robot_description": "std_msgs/msg/String"}
    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(
        bytes.fromhex(found["odom"]), "nav_msgs/msg/Odometry"
    )
    assert message.child_frame_id == "base_link"


async def test_a_client_that_stops_reading_does_not_disturb_the_others(stage, port):
    ticks = stage.robot.status()["loop"]["ticks"]
    async with asyncio.timeout(2 * DEADLINE_S), wired(port) as stuck, wired(port) as client:
        for one in (stuck, client):
            channels = await one.advertised(len(OFFERED) + 1)
            channels_wanted = [
                {"id": number, "channelId": channel["id"]}
                for number, channel in enumerate(channels.values())
            ]
            await one.send("subscribe", subscriptions=channels_wanted)
        for _ in range(200):
            await client.received(MESSAGE_DATA)
    assert stage.robot.status()["loop"]["ticks"] > ticks


async def test_each_new_subscriber_gets_the_robot_description(stage, port):
    for _ in range(2):  # the server sends it to a second client, too
        async with asyncio.timeout(DEADLINE_S), wired(port) as client:
            channels = await client.advertised(len(OFFERED) + 1)
            channel = {"id": 9, "channelId": channels["/robot_description"]["id"]}
            await client.send("subscribe", subscriptions=[channel])
            raw = await client.received(MESSAGE_DATA)
        typestore = get_typestore(Stores.ROS2_JAZZY)
        text = typestore.deserialize_cdr(raw[13:], "std_msgs/msg/String")
        joints = ET.fromstring(text.data).findall("joint[@type='continuous']")
        assert [joint.get("name") for joint in joints] == ["left", "right"]
