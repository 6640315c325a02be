# SPDX-License-Identifier: Apache-2.0
"""Commands from an MQTT broker, each with the token:

    cmd_vel         {"token": ..., "header": {"stamp": ...}, "twist": {"linear": ..., ...}}
    joint_commands  {"token": ..., "header": {"stamp": ...}, "name": ["left"], "velocity": [2.5]}
    call            {"token": ..., "method": "arm", "id": 7}, which is answered, also where the
                    token is missing or wrong

on the topics of names.py. A retained message is old, so it is ignored; a message older than the
lease's lifetime is refused.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Coroutine, Mapping
from typing import TYPE_CHECKING, Any

import aiomqtt

from motord.bus.commands.gate import COMMANDS, URGENT, CommandGate, NotTaken, request_of, tag
from motord.bus.mqtt.connection import MqttConnection, taken
from motord.bus.mqtt.names import CALL
from motord.config import MqttInput
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

PAYLOAD_BYTES_MAX = 4096
CALLS_MAX, ANSWERS_MAX = 16, 64
"""Largest number of calls in progress, and of answers that the broker has not taken yet. A stop and
an emergency stop are carried out beyond both limits."""
REFUSALS_MAX = 4
"""Largest number of answers to calls without the token that the broker has not taken yet. More of
these calls get no answer, so they take no room from calls with the token."""

_log = logging.getLogger(__name__)


class MqttCommands:
    def __init__(self, name: str, section: MqttInput, runtime: Runtime) -> None:
        """Raises the errors of `MqttConnection` and `CommandGate`."""
        self._connection = MqttConnection(f"input.{name}", section, runtime)
        self._gate = CommandGate(name, section, runtime)
        names = self._connection.names
        self._commands = {names.received(topic): topic for topic in COMMANDS}
        self._call_topic = names.received(CALL)
        self._calls: set[asyncio.Task[None]] = set()
        self._refusals: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        async with TaskGroup() as tasks:
            tasks.create_task(self._gate.source.run())
            tasks.create_task(self._connection.keep(self._use))

    async def _use(self, client: aiomqtt.Client) -> None:
        commands = [(topic, 0) for topic in self._commands]
        await taken(client.subscribe([*commands, (self._call_topic, 1)]))
        async with TaskGroup() as tasks:
            async for message in client.messages:
                if message.retain:
                    _log.warning("%s: a retained message is ignored", message.topic)
                    continue
                with contextlib.suppress(NotTaken):  # logged by the command gate
                    self._take(client, message, tasks)

    def _take(self, client: aiomqtt.Client, message: aiomqtt.Message, tasks: TaskGroup) -> None:
        request = request_of(self._connection.decode, message.payload, PAYLOAD_BYTES_MAX)
        topic = self._commands.get(str(message.topic))
        try:
            self._gate.admit(request.get("token"))
        except NotTaken as error:
            if topic is None and len(self._refusals) < REFUSALS_MAX:
                answer = self._answer(client, request, error=str(error))
                _kept(tasks.create_task(answer), self._refusals)
            raise
        if topic is not None:
            self._gate.take(topic, request)
        else:
            _kept(tasks.create_task(self._call(client, request)), self._calls)

    def _call(
        self, client: aiomqtt.Client, request: Mapping[str, Any]
    ) -> Coroutine[Any, Any, None]:
        """Return the coroutine that serves the call. Raises NotTaken if not even an answer is
        possible."""
        if len(self._calls) < CALLS_MAX or request.get("method") in URGENT:
            return self._act(client, request)
        busy = self._gate.busy()
        if len(self._calls) >= ANSWERS_MAX:
            raise busy
        return self._answer(client, request, error=str(busy))

    async def _act(self, client: aiomqtt.Client, request: Mapping[str, Any]) -> None:
        try:
            reply = {"result": await self._gate.act(tag(request.get("method")))}
        except NotTaken as error:
            reply = {"error": str(error)}
        if len(self._calls) <= ANSWERS_MAX:
            await self._answer(client, request, **reply)

    async def _answer(
        self, client: aiomqtt.Client, request: Mapping[str, Any], **reply: object
    ) -> None:
        answer = {"id": tag(request.get("id")), "method": tag(request.get("method"))} | reply
        with contextlib.suppress(aiomqtt.MqttError):  # receiving has to go on
            await client.publish(self._connection.names.answer, self._connection.encode(answer), 1)


def _kept(task: asyncio.Task[None], tasks: set[asyncio.Task[None]]) -> None:
    """Keep the task in `tasks` until it is done."""
    tasks.add(task)
    task.add_done_callback(tasks.discard)
