# SPDX-License-Identifier: Apache-2.0
"""An ordinary ROS 2 node on DDS: its topics and services by their ROS names, and its place in the
graph (ros_discovery_info, rmw_dds_common)."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from types import SimpleNamespace
from typing import Any

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.delay import Delays
from motord.bus.commands.senders import Sender
from motord.bus.messages.cdr import decode, encode
from motord.bus.messages.table import type_hash, with_parts
from motord.bus.ros2 import names
from motord.bus.ros2.dds.participant import Discovery, Participant, Reader, Writer
from motord.bus.ros2.quality import Answer, Distribution, Quality, Take
from motord.bus.ros2.senders import Graph
from motord.bus.ros2.services.service import Service
from motord_hal.base.tasks import TaskGroup

_GRAPH_TYPES = {
    "humble": "rmw_dds_common_humble/msg/ParticipantEntitiesInfo",
    "jazzy": "rmw_dds_common/msg/ParticipantEntitiesInfo",
}
_GID_BYTES = {"humble": 24, "jazzy": 16}
"""RMW_GID_STORAGE_SIZE of rmw/types.h; bytes that DDS does not fill are zero."""
_GRAPH_QUALITY = Quality(depth=1, latched=True)
_OTHERS_QUALITY = Quality(depth=64, latched=True, alone=False)

_log = logging.getLogger(__name__)


class Publisher:
    def __init__(self, writer: Writer, kind: str) -> None:
        self._writer = writer
        self._kind = kind
        self._failing = False

    def publish(self, message: Any) -> None:
        """Send a message. A message that cannot be encoded, or that DDS does not take, is lost;
        only the first of a series is logged."""
        try:
            taken = self._writer.write(encode(self._kind, message))
        except ValueError as error:
            self._say(str(error))
            return
        if taken:
            self._failing = False
        else:
            self._say("DDS does not take it")

    def _say(self, text: str) -> None:
        if not self._failing:
            self._failing = True
            _log.warning("%s: not published: %s", self._writer.name, text)


class Node:
    """A ROS 2 node on DDS. Create its topics and services before `run`."""

    def __init__(
        self,
        name: str,
        namespace: str,
        domain_id: int,
        discovery: Discovery,
        interface: str | None = None,
        distribution: Distribution = "jazzy",
    ) -> None:
        """`distribution`: ROS 2 distribution of the other nodes, which read the graph. Raises
        DdsError."""
        self.name = name
        self.namespace = namespace
        self.remap: dict[str, str] = {}
        self.types: set[str] = set()
        self._participant = Participant(domain_id, discovery, interface)
        self._readers: list[Reader] = []
        self._writers: list[Writer] = []
        self._services: list[Service] = []
        self._running = asyncio.Lock()
        self._graph_type = _GRAPH_TYPES[distribution]
        self._gid_bytes = _GID_BYTES[distribution]
        self._graph = self._participant.writer(
            names.GRAPH_TOPIC, self._graph_type, _GRAPH_QUALITY, _typed(self._graph_type)
        )
        self._others = Graph()
        self._participant.node_of = self._others.node
        self._participant.reader(
            names.GRAPH_TOPIC, self._graph_type, _OTHERS_QUALITY, _typed(self._graph_type),
            self._learn,
        )  # fmt: skip

    def _learn(self, raw: bytes, _: Any) -> None:
        """Take the names of other nodes from a message of the graph. A message of another
        distribution cannot be decoded, and its nodes stay without a name."""
        with contextlib.suppress(ValueError):
            self._others.learn(decode(self._graph_type, raw))

    def full(self, name: str) -> str:
        """Return a name with its namespace, replaced by the rules in `remap`."""
        return names.remapped(self.namespace, self.name, name, self.remap)

    def publisher(self, name: str, kind: str, quality: Quality | None = None) -> Publisher:
        """Create a publisher. `kind`: a type of `table.TYPES`. Raises DdsError."""
        topic = names.topic(self.full(name))
        writer = self._participant.writer(topic, kind, quality or Quality(), _typed(kind))
        self.types.add(kind)
        self._writers.append(writer)
        return Publisher(writer, kind)

    def subscribe(self, name: str, kind: str, take: Take, quality: Quality | None = None) -> None:
        """Implement `nodes.Node.subscribe`. Raises DdsError."""
        topic = names.topic(self.full(name))
        voice, delays = RateLimitedLog(_log), Delays()

        def taken(raw: bytes, info: Any) -> None:
            try:
                message = decode(kind, raw)
            except ValueError as error:
                voice.say(f"{topic}: not understood: {error}")
                return
            gid = reader.writer_gid(info.publication_handle)
            sender = Sender(self._others.name(gid), info.publication_handle)
            take(message, delays.waited_s(info.publication_handle, info.source_timestamp), sender)

        reader = self._participant.reader(topic, kind, quality or Quality(), _typed(kind), taken)
        self._readers.append(reader)
        self.types.add(kind)

    def reader(self, name: str, kind: str, quality: Quality) -> Reader:
        """Create a reader whose samples are taken elsewhere as they arrive. Raises DdsError."""
        self.types.add(kind)
        topic = names.topic(self.full(name))
        self._readers.append(self._participant.reader(topic, kind, quality, _typed(kind), None))
        return self._readers[-1]

    def writer_of(self, reader: Reader, handle: int) -> str:
        """Return the name of the node that sent a sample. `handle`: DDS's handle of the sample's
        writer."""
        return self._others.name(reader.writer_gid(handle))

    def serve(
        self, name: str, kind: str, answer: Answer, depth: int = 10, together: int = 1
    ) -> None:
        """Implement `nodes.Node.serve`. Raises DdsError."""
        service = Service(
            self._participant, self.full(name), kind, answer, self._others.name, depth, together
        )
        self.types.update(with_parts(kind))
        self._services.append(service)
        self._readers.append(service.reader)
        self._writers.append(service.writer)

    async def run(self) -> None:
        """Run the node until cancelled. When several adapters share the node, one of them runs it
        for all; if that one fails, the next one does."""
        async with self._running, TaskGroup() as tasks:
            self._announce()
            for service in self._services:
                tasks.create_task(service.run())
            tasks.create_task(self._participant.run())

    def _announce(self) -> None:
        node = SimpleNamespace(
            node_namespace=self.namespace,
            node_name=self.name,
            reader_gid_seq=[self._gid(reader.gid) for reader in self._readers],
            writer_gid_seq=[self._gid(writer.gid) for writer in self._writers],
        )
        info = SimpleNamespace(gid=self._gid(self._participant.gid), node_entities_info_seq=[node])
        self._graph.write(encode(self._graph_type, info))

    def _gid(self, raw: bytes) -> SimpleNamespace:
        return SimpleNamespace(data=raw.ljust(self._gid_bytes, b"\0"))


def _typed(kind: str) -> str:
    return f"typehash={type_hash(kind)};"
