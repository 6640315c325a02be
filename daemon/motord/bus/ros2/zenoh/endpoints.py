# SPDX-License-Identifier: Apache-2.0
"""A node's topics and services on Zenoh, in the form of rmw_zenoh. Each is declared on a session,
and again on each new session. Zenoh calls back in its own threads: a callback only puts what
arrived into a queue and wakes the event loop, once for all that the queue holds."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import OrderedDict
from typing import Any, Protocol

import zenoh
import zenoh.ext

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.delay import Delays
from motord.bus.commands.senders import Sender
from motord.bus.inbox import Inbox
from motord.bus.messages.cdr import decode, encode
from motord.bus.ros2.dds.other_types import type_conflict
from motord.bus.ros2.quality import Answer, Quality, Take
from motord.bus.ros2.senders import SENDERS_MAX, asker, unnamed
from motord.bus.ros2.zenoh.names import (
    PUBLISHER,
    SERVER,
    SUBSCRIPTION,
    Attachment,
    NodeNames,
    gid,
    node_of,
    quality_text,
    type_of,
)
from motord_hal.base.tasks import TaskGroup

WAITING_MAX = 32
"""Largest number of requests that wait; more are refused."""

_log = logging.getLogger(__name__)


class Endpoint(Protocol):
    def declare(self, session: zenoh.Session, names: NodeNames, number: int) -> None:
        """Declare the endpoint on the session. `number`: its number in the node. Raises
        zenoh.ZError."""
        ...


def _token(
    session: zenoh.Session, names: NodeNames, number: int, endpoint: tuple[str, str, str, Quality]
) -> tuple[str, zenoh.LivelinessToken]:
    what, topic, kind, quality = endpoint
    words = quality_text(depth=quality.depth, reliable=quality.reliable, latched=quality.latched)
    token = names.endpoint_token(number, what, topic, kind, words)
    return token, session.liveliness().declare_token(token)


class Publisher:
    def __init__(self, topic: str, kind: str, quality: Quality) -> None:
        self._topic, self._kind, self._quality = topic, kind, quality
        self._entity: zenoh.Publisher | zenoh.ext.AdvancedPublisher | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._gid = bytes(16)
        self._sequence = 0
        self._latched: bytes | None = None
        self._failing = False

    def declare(self, session: zenoh.Session, names: NodeNames, number: int) -> None:
        """Implement `Endpoint.declare`; send the latched message again."""
        key = names.key(self._topic, self._kind)
        if self._quality.latched:
            self._entity = zenoh.ext.declare_advanced_publisher(
                session,
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                cache=zenoh.ext.CacheConfig(self._quality.depth),
                publisher_detection=True,
            )
        else:
            self._entity = session.declare_publisher(
                key, congestion_control=zenoh.CongestionControl.DROP
            )
        endpoint = (PUBLISHER, self._topic, self._kind, self._quality)
        token, self._token = _token(session, names, number, endpoint)
        self._gid = gid(token)
        if self._latched is not None:
            self._put(self._latched)

    def publish(self, message: Any) -> None:
        """Send a message without waiting. A message that cannot be encoded, or that Zenoh does not
        take, is lost; only the first of a series is logged."""
        try:
            raw = bytes(encode(self._kind, message))
        except ValueError as error:
            self._say(str(error))
            return
        if self._quality.latched:
            self._latched = raw
        self._put(raw)

    def _put(self, raw: bytes) -> None:
        if self._entity is None:
            return  # no session yet, which the node logs
        self._sequence += 1
        attachment = Attachment(self._sequence, time.time_ns(), self._gid).encode()
        try:
            self._entity.put(raw, attachment=attachment)
        except zenoh.ZError as error:
            self._say(str(error))
        else:
            self._failing = False

    def _say(self, text: str) -> None:
        if not self._failing:
            self._failing = True
            _log.warning("%s: not published: %s", self._topic, text)


class Subscription:
    def __init__(self, topic: str, kind: str, quality: Quality, take: Take) -> None:
        self._topic, self._kind, self._quality = topic, kind, quality
        self._hand_over = take
        self._inbox: Inbox[tuple[bytes, bytes]] = Inbox(quality.depth, self._take)
        self._delays, self._voice = Delays(), RateLimitedLog(_log)
        self._publishers: Inbox[str] = Inbox(WAITING_MAX, self._look_at)
        self._names: OrderedDict[bytes, str] = OrderedDict()
        self._kept: tuple[Any, ...] = ()

    def declare(self, session: zenoh.Session, names: NodeNames, number: int) -> None:
        """Implement `Endpoint.declare`."""
        self._inbox.open()
        key = names.key(self._topic, self._kind)
        endpoint = (SUBSCRIPTION, self._topic, self._kind, self._quality)
        subscriber = session.declare_subscriber(key, self._arrived)
        self._publishers.open()
        others = session.liveliness().declare_subscriber(
            names.any_publisher(self._topic), self._announced, history=True
        )
        self._kept = (subscriber, others, *_token(session, names, number, endpoint))

    def _arrived(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
            self._inbox.put((sample.payload.to_bytes(), attachment))

    def _announced(self, token: zenoh.Sample) -> None:
        if token.kind == zenoh.SampleKind.PUT:
            self._publishers.put(str(token.key_expr))

    def _look_at(self, token: str) -> None:
        self._names[gid(token)] = node_of(token)
        if len(self._names) > SENDERS_MAX:
            self._names.popitem(last=False)
        conflict = type_conflict(self._topic, "writer", self._kind, type_of(token))
        if conflict is not None:
            self._voice.say(conflict)

    def _take(self, arrived: tuple[bytes, bytes]) -> None:
        raw, attachment = arrived
        try:
            message = decode(self._kind, raw)
        except ValueError as error:
            self._voice.say(f"{self._topic}: not understood: {error}")
            return
        try:
            sent = Attachment.decode(attachment)
        except ValueError:  # ROS 2 did not send it; it is taken all the same
            self._hand_over(message, 0.0, Sender("a program that is no ROS 2 node"))
            return
        sender = Sender(self._names.get(sent.gid) or unnamed(sent.gid), sent.gid)
        self._hand_over(message, self._delays.waited_s(sent.gid, sent.stamp_ns), sender)


class Service:
    def __init__(self, name: str, kind: str, answer: Answer, depth: int, together: int = 1) -> None:
        """`together`: largest number of answers in progress at once."""
        self._together = together
        self._name, self._kind = name, kind
        self._quality = Quality(depth=depth)
        self._answer = answer
        self._inbox: Inbox[zenoh.Query] = Inbox(WAITING_MAX, self._take)
        self._waiting: asyncio.Queue[zenoh.Query] = asyncio.Queue(WAITING_MAX)
        self._voice = RateLimitedLog(_log)
        self._key = ""
        self._kept: tuple[Any, ...] = ()

    def declare(self, session: zenoh.Session, names: NodeNames, number: int) -> None:
        """Implement `Endpoint.declare`."""
        self._inbox.open()
        self._key = names.key(self._name, self._kind)
        queryable = session.declare_queryable(self._key, self._inbox.put, complete=True)
        endpoint = (SERVER, self._name, self._kind, self._quality)
        self._kept = (queryable, *_token(session, names, number, endpoint))

    def _take(self, query: zenoh.Query) -> None:
        try:
            self._waiting.put_nowait(query)
        except asyncio.QueueFull:
            _refuse(query, f"{WAITING_MAX} requests wait")

    async def run(self) -> None:
        """Answer until cancelled."""
        async with TaskGroup() as tasks:
            for _ in range(self._together):
                tasks.create_task(self._serve_all())

    async def _serve_all(self) -> None:
        while True:
            query = await self._waiting.get()
            try:
                await self._serve(query)
            except (ValueError, zenoh.ZError) as error:
                self._voice.say(f"service {self._name}: not answered: {error}")
                _refuse(query, str(error))

    async def _serve(self, query: zenoh.Query) -> None:
        """Answer a request. Raises ValueError for a query that is no request of a ROS 2 client,
        such as one with a wildcard in its key."""
        if str(query.key_expr) != self._key:
            raise ValueError(f"{query.key_expr} is not the key of a request")
        if query.payload is None or query.attachment is None:
            raise ValueError("a request has a payload and an attachment")
        asked = Attachment.decode(query.attachment.to_bytes())
        request = decode(f"{self._kind}_Request", query.payload.to_bytes())
        asker.set(unnamed(asked.gid))
        reply = encode(f"{self._kind}_Response", await self._answer(request))
        attachment = Attachment(asked.sequence, time.time_ns(), asked.gid).encode()
        with query:
            query.reply(self._key, bytes(reply), attachment=attachment)


def _refuse(query: zenoh.Query, text: str) -> None:
    try:
        with query:
            query.reply_err(text)
    except zenoh.ZError as error:
        _log.debug("the refusal did not reach the client: %s", error)
