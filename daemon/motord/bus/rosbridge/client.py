# SPDX-License-Identifier: Apache-2.0
"""One client of the rosbridge server: what it subscribes to, and what it requests."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Iterator, Mapping
from typing import Any

from aiohttp import WSMsgType, web

from motord.api.snapshot import stop_answer
from motord.bus.commands.gate import TRIGGERS, URGENT, CommandGate, NotTaken, short, tag
from motord.bus.commands.senders import Sender
from motord.bus.messages import json_form
from motord.bus.messages.topics import TOPICS
from motord_hal.base.tasks import TaskGroup

CALLS_MAX, ANSWERS_MAX = 16, 64
"""Largest number of calls in progress, and of answers that the client has not read yet. A stop and
an emergency stop are always carried out."""
THROTTLE_MAX_MS = 3_600_000


class RosbridgeClient:
    """A client of the server. `offer` never waits: for a slow client only the newest message of
    each topic is kept."""

    def __init__(
        self,
        connection: web.WebSocketResponse,
        rates_hz: Mapping[str, float],
        gate: CommandGate | None,
    ) -> None:
        self._connection = connection
        self._gate = gate
        self._rates_hz = rates_hz
        self._every_s: dict[str, float] = {}
        """Shortest time between two messages, by topic that the client has subscribed to."""
        self._sent_s: dict[str, float] = {}
        self._newest: dict[str, str] = {}
        self._arrived = asyncio.Event()
        self._calls = 0

    # ------------------------------------------------------------------------------------- sending
    def wants(self, topic: str) -> bool:
        """Return whether the client has subscribed to a topic, and the shortest time since its last
        message is over."""
        every_s = self._every_s.get(topic)
        if every_s is None:
            return False
        return time.monotonic() - self._sent_s.get(topic, -math.inf) >= every_s

    def offer(self, topic: str, text: str) -> bool:
        """Keep a message for sending; return whether an older one was lost for it."""
        lost = topic in self._newest
        self._sent_s[topic] = time.monotonic()
        self._newest[topic] = text
        self._arrived.set()
        return lost

    async def run(self) -> None:
        """Serve the client until it is gone. Raises OSError in a group if its connection fails."""
        async with TaskGroup() as tasks:
            sending = tasks.create_task(self._send_newest())
            async for message in self._connection:
                if message.type not in (WSMsgType.TEXT, WSMsgType.BINARY):
                    break  # what aiohttp found to be no message has ended the connection
                with contextlib.suppress(NotTaken):  # logged by the command gate
                    await self._take(message.data, tasks)
            sending.cancel()

    async def _send_newest(self) -> None:
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            newest, self._newest = self._newest, {}
            for text in newest.values():
                await self._connection.send_str(text)

    # -------------------------------------------------------------------------------------- asking
    async def _take(self, raw: str | bytes, tasks: TaskGroup) -> None:
        try:
            request = json_form.decode(raw)
        except ValueError:
            request = None
        if not isinstance(request, Mapping):
            await self._say("error", "a message is a JSON object")
            return
        topic = _name(request.get("topic"))
        match request.get("op"):
            case "subscribe":
                await self._subscribe(topic, request)
            case "unsubscribe":
                self._every_s.pop(topic, None)
            case "publish":
                await self._publish(topic, request.get("msg"))
            case "call_service":
                await self._ask(request, tasks)
            case "advertise" | "unadvertise" | "status" | "set_level":
                pass  # nothing follows from it
            case other:
                await self._say("error", f"op {short(other)} is not served", request.get("id"))

    async def _subscribe(self, topic: str, request: Mapping[str, Any]) -> None:
        if topic not in self._rates_hz:
            known = ", ".join(f"/{name}" for name in self._rates_hz)
            await self._say(
                "error", f"no topic {short(topic)}; there are: {known}", request.get("id")
            )
            return
        throttle_ms = request.get("throttle_rate", 0)
        if not isinstance(throttle_ms, int | float) or not 0 <= throttle_ms <= THROTTLE_MAX_MS:
            throttle_ms = 0
        self._every_s[topic] = throttle_ms / 1e3

    async def _publish(self, topic: str, message: object) -> None:
        if self._gate is None:
            await self._say("error", "this server only publishes: it takes no messages")
        else:
            try:
                self._gate.take(topic, message, sender=Sender(key=self))
            except NotTaken as error:
                await self._say("error", str(error))

    async def _ask(self, request: Mapping[str, Any], tasks: TaskGroup) -> None:
        urgent = _name(request.get("service")) in URGENT
        if self._calls < (ANSWERS_MAX if urgent else CALLS_MAX):
            self._calls += 1
            tasks.create_task(self._call(request))
        elif urgent:  # done first; then nothing more is read until the client reads
            await self._respond(request, await self._done(request))
        else:
            busy = "busy" if self._gate is None else str(self._gate.busy())
            await self._respond(request, {"values": busy, "result": False})

    async def _call(self, request: Mapping[str, Any]) -> None:
        try:
            await self._respond(request, await self._done(request))
        finally:
            self._calls -= 1

    async def _done(self, request: Mapping[str, Any]) -> dict[str, Any]:
        try:
            return {"values": await self._served(_name(request.get("service"))), "result": True}
        except NotTaken as error:
            return {"values": str(error), "result": False}

    async def _respond(self, request: Mapping[str, Any], answer: dict[str, Any]) -> None:
        service, number = tag(request.get("service")), tag(request.get("id"))
        head = {"op": "service_response", "service": service, "id": number}
        await self._send(head | answer)

    async def _served(self, service: str) -> dict[str, Any]:
        """Carry out a call of a service, and return its values. Raises NotTaken."""
        if service == "rosapi/topics":
            return {
                "topics": [f"/{name}" for name in self._rates_hz],
                "types": [TOPICS[name].type_name for name in self._rates_hz],
            }
        if service == "rosapi/services":
            return {"services": list(self._services())}
        if self._gate is None:
            raise NotTaken("this server only publishes: none of its services moves the robot")
        if service not in TRIGGERS:
            raise NotTaken(f"no service {short(service)}; there are: {', '.join(self._services())}")
        try:
            done = await self._gate.act(service)
        except NotTaken as error:
            return {"success": False, "message": str(error)}
        success, message = stop_answer(service, done)
        return {"success": success, "message": message}

    def _services(self) -> Iterator[str]:
        yield from ("/rosapi/topics", "/rosapi/services")
        if self._gate is not None:
            yield from (f"/{name}" for name in TRIGGERS)

    async def _say(self, level: str, text: str, number: object = None) -> None:
        await self._send({"op": "status", "level": level, "msg": text, "id": tag(number)})

    async def _send(self, message: dict[str, Any]) -> None:
        await self._connection.send_str(json.dumps(json_form.plain(message), allow_nan=False))


def _name(value: object) -> str:
    """Return a topic or service without its slash; empty for a value that is no name."""
    return value.removeprefix("/") if isinstance(value, str) else ""
