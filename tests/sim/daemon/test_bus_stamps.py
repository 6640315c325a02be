# SPDX-License-Identifier: Apache-2.0
"""Stamps as a subscriber of a bus gets them: one for each measurement, once, and never earlier
ones, except where the clock was set."""

import asyncio
import json
import time

import pytest
from aiohttp import ClientSession
from tests.sim.daemon.test_bus_process import free_port
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, SURE, running

from motord.base.wall_clock import WallClock
from motord.bus.runtime import Runtime
from motord.config import load_robot
from motord.config.sections.bus import ALL_TOPICS

RATE_HZ = 100
MESSAGES = 300
TOPICS = tuple(topic for topic in ALL_TOPICS if topic != "imu")
"""Topics of the demonstration's robot."""
SLOW = ("battery_state", "diagnostics", "loop_statistics")
"""Topics of at most 1 Hz."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("stamps"), *SURE) as stage:
        stage.wait_for("idle")
        yield stage


class Stamps:
    """Stamps of each topic in ns, in the order of their messages."""

    def __init__(self):
        self.of = {topic: [] for topic in TOPICS}

    def take(self, topic, message):
        head = message["transforms"][0]["header"] if topic == "tf" else message["header"]
        stamp = head["stamp"]
        self.of[topic].append(stamp["sec"] * 1_000_000_000 + stamp["nanosec"])

    def backward(self, topic):
        """Return how often a stamp is earlier than the one before it."""
        return sum(b < a for a, b in zip(self.of[topic], self.of[topic][1:], strict=False))


async def received(port, until, stamps):
    """Subscribe to all topics, and take messages until the condition holds."""
    async with asyncio.timeout(DEADLINE_S), ClientSession() as session:
        connection = None
        while connection is None:
            try:
                connection = await session.ws_connect(f"http://127.0.0.1:{port}/")
            except OSError:
                await asyncio.sleep(0.05)
        async with connection:
            for topic in TOPICS:
                await connection.send_str(json.dumps({"op": "subscribe", "topic": f"/{topic}"}))
            while not until():
                answer = json.loads((await connection.receive()).data)
                if answer["op"] == "publish":
                    stamps.take(answer["topic"].removeprefix("/"), answer["msg"])


async def test_no_subscriber_gets_a_stamp_twice_or_an_earlier_one(stage, caplog):
    port, moved_ns = free_port(), 0

    def wall_ns():
        return time.time_ns() + moved_ns

    name = stage.robot.call("robot")["robot"]
    overrides = (
        f"robot.name={name}", "publish.tell.kind=rosbridge", f"publish.tell.port={port}",
        f"publish.tell.rate_hz={RATE_HZ}",
        *(f"publish.tell.topic_rate_hz.{topic}={RATE_HZ}" for topic in SLOW),
    )  # fmt: skip
    robot = load_robot(ROBOT, overrides)
    runtime = Runtime(robot, stage.socket, WallClock(time.monotonic_ns, wall_ns))
    stamps = Stamps()
    fast = [topic for topic in TOPICS if topic not in SLOW]
    async with asyncio.TaskGroup() as tasks:
        running_bus = tasks.create_task(runtime.run())

        def many(count):
            seldom = count // MESSAGES * 2
            return all(len(stamps.of[topic]) >= count for topic in fast) and all(
                len(stamps.of[topic]) >= seldom for topic in SLOW
            )

        await received(port, lambda: many(MESSAGES), stamps)
        before = {topic: stamps.backward(topic) for topic in TOPICS}
        moved_ns = -7_000_000_000
        count = {topic: len(stamps.of[topic]) for topic in TOPICS}
        await received(
            port,
            lambda: all(len(stamps.of[topic]) >= count[topic] + 3 for topic in TOPICS),
            stamps,
        )
        running_bus.cancel()
    assert before == dict.fromkeys(TOPICS, 0)
    for topic in TOPICS:
        assert len(set(stamps.of[topic])) == len(stamps.of[topic]), topic
        assert stamps.backward(topic) == 1, f"{topic}: when the clock was set"
    assert len([row for row in caplog.records if "clock was set" in row.getMessage()]) == 1
