# SPDX-License-Identifier: Apache-2.0
"""A node that several sections share stays up when one of them fails."""

import asyncio
from types import SimpleNamespace

from tests.peers.ros2.ros2_stage import DOMAIN

from motord.bus.ros2.dds.node import Node

DEADLINE_S = 30.0
STRING = "std_msgs/msg/String"


async def test_a_shared_node_survives_the_end_of_a_section_and_can_run_again():
    node, received = Node("shared", "/shared", DOMAIN, "localhost"), set()
    node.subscribe("words", STRING, lambda message, *_: received.add(message.data))
    sender = node.publisher("words", STRING)

    async def is_received(text):
        while text not in received:
            sender.publish(SimpleNamespace(data=text))
            await asyncio.sleep(0.02)

    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        first, second = (tasks.create_task(node.run()) for _ in range(2))
        await is_received("by the first")
        first.cancel()
        await asyncio.wait([first])
        await is_received("by the second")
        second.cancel()
        await asyncio.wait([second])
        again = tasks.create_task(node.run())
        await is_received("again")
        again.cancel()
