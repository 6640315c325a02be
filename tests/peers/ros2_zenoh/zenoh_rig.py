# SPDX-License-Identifier: Apache-2.0
"""A peer for ROS 2 on Zenoh. rosbags encodes its messages; only attachments use code of motord."""

import asyncio
import contextlib
import json
import time

import rosbags.typesys as rosbags
import zenoh
import zenoh.ext
from tests.peers.ros2_zenoh.zenoh_router import endpoint

from motord.bus.ros2.zenoh.names import Attachment

STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
STORE.register(rosbags.get_types_from_msg("bool success\nstring message\n", "peer/msg/Answer"))

WITHIN_S = 30.0

GID = bytes(range(16))


async def until(condition):
    async with asyncio.timeout(WITHIN_S):
        while not condition():
            await asyncio.sleep(0.01)


@contextlib.contextmanager
def peer(port):
    settings = {
        "mode": "client",
        "connect": {"endpoints": [endpoint(port)]},
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as session:
        yield session


@contextlib.asynccontextmanager
async def running(node):
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(node.run())
        try:
            yield
        finally:
            task.cancel()


class Tokens:
    """The liveliness tokens that the router reports: one for each node and endpoint."""

    def __init__(self, session):
        self.alive = set()
        self.gone = []
        self._kept = session.liveliness().declare_subscriber(
            "@ros2_lv/3/**", self._changed, history=True
        )

    def _changed(self, sample):
        token = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self.alive.add(token)
        else:
            self.alive.discard(token)
            self.gone.append(token)

    def of(self, what):
        return [token for token in set(self.alive) if token.split("/")[5] == what]


def attached(sequence=1):
    return Attachment(sequence, time.time_ns(), GID).encode()


def ask(session, key, target=zenoh.QueryTarget.ALL_COMPLETE, **more):
    """Query `key` and return all answers. It blocks until they are there: call it in a thread."""
    return list(session.get(key, target=target, timeout=10.0, **more))


REQUEST = b"\x00\x01\x00\x00\x00"
