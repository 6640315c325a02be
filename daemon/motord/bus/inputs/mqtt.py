# SPDX-License-Identifier: Apache-2.0
"""Commands from an MQTT broker, each with the token:

    PREFIX/cmd_vel   {"token": ..., "header": {"stamp": ...}, "twist": {"linear": ..., ...}}
    PREFIX/call      {"token": ..., "method": "arm", "id": 7}, answered on PREFIX/answer

A retained message is none of now and is not obeyed; nor is what is older than the lease's lifetime.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import aiomqtt

from motord.bus.inputs.desk import Desk, NotTaken, tag
from motord.bus.mqtt_connection import MqttConnection
from motord.config import MqttInput

if TYPE_CHECKING:
    from motord.bus.station import Station

PAYLOAD_BYTES_MAX = 4096
TASKS_MAX = 16

_log = logging.getLogger(__name__)


class MqttCommands:
    def __init__(self, name: str, section: MqttInput, station: Station) -> None:
        """Raises as MqttConnection and Desk."""
        self._connection = MqttConnection(f"input.{name}", section, station)
        self._desk = Desk(name, section, station)
        self._drive_topic = f"{self._connection.prefix}/cmd_vel"
        self._call_topic = f"{self._connection.prefix}/call"
        self._answer_topic = f"{self._connection.prefix}/answer"
        self._calls: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """As Adapter.run."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._desk.source.run())
            tasks.create_task(self._connection.keep(self._use))

    async def _use(self, client: aiomqtt.Client) -> None:
        await client.subscribe([(self._drive_topic, 0), (self._call_topic, 1)])
        async with asyncio.TaskGroup() as tasks:
            async for message in client.messages:
                if message.retain:
                    _log.warning("%s: a retained message is not obeyed", message.topic)
                    continue
                with contextlib.suppress(NotTaken):  # said by the desk
                    self._take(client, message, tasks)

    def _take(
        self, client: aiomqtt.Client, message: aiomqtt.Message, tasks: asyncio.TaskGroup
    ) -> None:
        request = self._request(message.payload)
        self._desk.admit(request.get("token"))
        if str(message.topic) == self._drive_topic:
            self._desk.drive(request)
        elif len(self._calls) < TASKS_MAX:
            call = tasks.create_task(self._act(client, request))
            self._calls.add(call)
            call.add_done_callback(self._calls.discard)

    def _request(self, payload: Any) -> Mapping[str, Any]:
        """Nothing that could have a token: an empty one."""
        if not isinstance(payload, bytes) or len(payload) > PAYLOAD_BYTES_MAX:
            return {}
        try:
            request = self._connection.decode(payload)
        except ValueError:
            return {}
        return request if isinstance(request, Mapping) else {}

    async def _act(self, client: aiomqtt.Client, request: Mapping[str, Any]) -> None:
        number, method = tag(request.get("id")), tag(request.get("method"))
        answer: dict[str, Any] = {"id": number, "method": method}
        try:
            answer["result"] = await self._desk.act(method)
        except NotTaken as error:
            answer["error"] = str(error)
        await client.publish(self._answer_topic, self._connection.encode(answer), 1)
