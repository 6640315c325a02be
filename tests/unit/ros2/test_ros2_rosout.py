# SPDX-License-Identifier: Apache-2.0
"""The log of a ROS 2 node, published on /rosout."""

import asyncio
import logging

from motord.bus.messages.cdr import decode, encode
from motord.bus.ros2.rosout import LOG, Rosout

log = logging.getLogger("motord.test")


class Topic:
    """Keeps the published messages, encoded and decoded again."""

    def __init__(self):
        self.sent = []

    def publish(self, message):
        self.sent.append(decode(LOG, bytes(encode(LOG, message))))


async def test_warnings_and_errors_of_any_thread_are_sent_and_the_rest_is_not():
    topic = Topic()
    with Rosout("/r2/motord", topic).log.listening():
        log.info("all is well")
        log.warning("two %s", "rivals")
        await asyncio.to_thread(log.error, "no route")
        async with asyncio.timeout(10.0):
            while len(topic.sent) < 2:
                await asyncio.sleep(0)
    log.warning("afterwards")
    await asyncio.sleep(0)
    assert [(one.level, one.msg, one.name) for one in topic.sent] == [
        (30, "two rivals", "r2.motord"), (40, "no route", "r2.motord")
    ]  # fmt: skip
    assert topic.sent[0].file == "test_ros2_rosout.py"


async def test_each_cause_of_a_fault_is_sent_once():
    topic = Topic()
    rosout = Rosout("/motord", topic)
    for why in ((), ("estop: by /panel",), ("estop: by /panel",), ("estop: by /panel", "a wheel")):
        rosout.look(why)
    assert [one.msg for one in topic.sent] == ["estop: by /panel", "a wheel"]
    rosout.look(())
    rosout.look(("a wheel",))
    assert len(topic.sent) == 3
