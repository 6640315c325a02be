# SPDX-License-Identifier: Apache-2.0
"""Commands from an MQTT broker, each with the token:

    cmd_vel         {"token": ..., "header": {"stamp": ...}, "twist": {"linear": ..., ...}}
    joint_commands  {"token": ..., "header": {"stamp": ...}, "name": ["left"], "velocity": [2.5]}
    call            {"token": ..., "method": "arm", "id": 7}, which is answered

on topics by mqtt_names.py. A retained message is none of now and is not obeyed; nor is what is
older than the lease's lifetime.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import aiomqtt

from motord.bus.inputs.desk import COMMANDS, Desk, NotTaken, request_of, tag
from motord.bus.mqtt_connection import MqttConnection
from motord.bus.mqtt_names import CALL
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
        names = self._connection.names
        self._commands = {names.heard(topic): topic for topic in COMMANDS}
        self._call_topic = names.heard(CALL)
        self._calls: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """As Adapter.run."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._desk.source.run())
            tasks.create_task(self._connection.keep(self._use))

    async def _use(self, client: aiomqtt.Client) -> None:
        commands = [(topic, 0) for topic in self._commands]
        await client.subscribe([*commands, (self._call_topic, 1)])
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
        request = request_of(self._connection.decode, message.payload, PAYLOAD_BYTES_MAX)
        self._desk.admit(request.get("token"))
        if (topic := self._commands.get(str(message.topic))) is not None:
            self._desk.take(topic, request)
        elif len(self._calls) < TASKS_MAX:
            call = tasks.create_task(self._act(client, request))
            self._calls.add(call)
            call.add_done_callback(self._calls.discard)

    async def _act(self, client: aiomqtt.Client, request: Mapping[str, Any]) -> None:
        number, method = tag(request.get("id")), tag(request.get("method"))
        answer: dict[str, Any] = {"id": number, "method": method}
        try:
            answer["result"] = await self._desk.act(method)
        except NotTaken as error:
            answer["error"] = str(error)
        await client.publish(self._connection.names.answer, self._connection.encode(answer), 1)
