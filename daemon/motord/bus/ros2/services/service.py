# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 service in the form of rmw_cyclonedds: a topic of requests and a topic of replies, whose
messages begin with the client and the number of the request. Clients on another DDS middleware
carry these outside of the message, where the binding can neither read nor write them: a call would
wait for ever. So the service does not look available to them: rmw_fastrtps takes a service for
available that has as many writers of replies as readers of requests
(rmw_service_server_is_available.cpp), and there is one more writer here. rmw_cyclonedds looks for a
pair with the same `serviceid`, and ignores the additional writer."""

from __future__ import annotations

import asyncio
import itertools
import logging
import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from cyclonedds.core import DDSException

from motord.api.deadline import within
from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.messages.cdr import HEADER, decode, encode
from motord.bus.messages.table import type_hash
from motord.bus.ros2 import names
from motord.bus.ros2.dds.discovered import client_of
from motord.bus.ros2.dds.participant import Participant
from motord.bus.ros2.quality import Answer, Quality
from motord.bus.ros2.senders import asker
from motord_hal.base.tasks import TaskGroup

WAITING_MAX = 32
"""Largest number of requests that wait; more are not answered."""
MATCHED_WITHIN_S = 1.0
_MATCHED_EVERY_S = 0.01
_WHO = struct.Struct("<Qq")
_BODY = len(HEADER) + _WHO.size
_numbers = itertools.count(1)

_log = logging.getLogger(__name__)


class Service:
    def __init__(
        self,
        participant: Participant,
        name: str,
        kind: str,
        answer: Answer,
        name_of: Callable[[bytes], str],
        depth: int,
        together: int = 1,
    ) -> None:
        """`name_of` returns the name of a client by its endpoint. `together`: largest number of
        answers in progress at once. Raises DdsError."""
        self._name_of = name_of
        self._together = together
        self._request, self._reply = f"{kind}_Request", f"{kind}_Response"
        self._answer = answer
        self._name = name
        self._voice = RateLimitedLog(_log)
        self._waiting: asyncio.Queue[tuple[bytes, SimpleNamespace, int]] = asyncio.Queue(
            WAITING_MAX
        )
        quality, number = Quality(depth=depth), next(_numbers)
        raw_id = participant.gid[:12] + number.to_bytes(4, "big")
        service_id = ".".join(f"{byte:x}" for byte in raw_id)

        def type_of(of: str) -> str:
            return f"serviceid={service_id};typehash={type_hash(of)};"

        # Create the reader last: no client can find it while there is only one writer.
        participant.mute_writer(
            names.reply(name), self._reply, quality, f"typehash={type_hash(self._reply)};"
        )
        self.writer = participant.writer(
            names.reply(name), self._reply, quality, type_of(self._reply), name
        )
        self.reader = participant.reader(
            names.request(name), self._request, quality, type_of(self._request), self._take, name
        )

    def _take(self, raw: bytes, info: Any) -> None:
        try:
            # The header is 16 bytes long: what follows is aligned as if it were not there.
            request = decode(self._request, HEADER + raw[_BODY:])
        except ValueError as error:
            self._voice.say(f"service {self._name}: not understood: {error}")
            return
        try:
            self._waiting.put_nowait((raw[len(HEADER) : _BODY], request, info.publication_handle))
        except asyncio.QueueFull:
            self._voice.say(f"service {self._name}: {WAITING_MAX} requests wait, one is dropped")

    async def run(self) -> None:
        """Answer until cancelled."""
        async with TaskGroup() as tasks:
            for _ in range(self._together):
                tasks.create_task(self._serve())

    async def _serve(self) -> None:
        while True:
            who, request, client = await self._waiting.get()
            asker.set(self._name_of(self.reader.writer_gid(client)))
            reply = encode(self._reply, await self._answer(request))
            await self._matched(client)
            self.writer.write(bytearray(HEADER + who) + reply[len(HEADER) :])

    async def _matched(self, client: int) -> None:
        """Wait until the client receives replies: one that was just created may not yet. Return at
        once for a client that has no id or is gone."""
        name = self._client_id(client)
        if name is None:
            return
        try:
            async with within(MATCHED_WITHIN_S):
                while name not in self._hearing():  # noqa: ASYNC110  DDS has no event for it
                    await asyncio.sleep(_MATCHED_EVERY_S)
        except TimeoutError:
            self._voice.say(f"service {self._name}: the client receives no replies")

    def _client_id(self, handle: int) -> bytes | None:
        try:
            found = self.reader.entity.get_matched_publication_data(handle)
        except DDSException:
            return None
        return None if found is None else client_of(found.qos)

    def _hearing(self) -> set[bytes | None]:
        received: set[bytes | None] = set()
        for handle in self.writer.entity.get_matched_subscriptions():
            try:
                found = self.writer.entity.get_matched_subscription_data(handle)
            except DDSException:
                continue  # it has just gone
            if found is not None:
                received.add(client_of(found.qos))
        return received
