# SPDX-License-Identifier: Apache-2.0
"""A live view for Foxglove: the WebSocket server of foxglove-sdk, with the types and the encoding
of ROS 2. As a publisher it only sends; as an input it takes commands from clients with the token.

Threads of the SDK serve the clients, and drop messages for a client that is slow.
"""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.websocket import Capability, WebSocketServer

from motord.api.deadline import within
from motord.bus.foxglove.clients import ENCODING, Commands, Looks
from motord.bus.messages.forms import as_cdr, stamp_ns
from motord.bus.messages.table import definition
from motord.bus.messages.topics import TOPICS
from motord.bus.ros2.urdf import DESCRIPTION, STRING, description
from motord.config import FoxgloveInput, FoxgloveServer
from motord_hal.base import bounded
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

LISTEN_AGAIN_S = 5.0
STOP_WITHIN_S = 5.0
BACKLOG = 64
"""Largest number of messages that wait for one client."""

_log = logging.getLogger(__name__)


class FoxgloveAdapter:
    def __init__(self, name: str, section: FoxgloveServer, runtime: Runtime) -> None:
        """Raises OSError for a certificate that cannot be read, and the errors of `CommandGate`."""
        self._section = section
        self._robot = runtime.body.robot
        self._context = Context()
        looks = self._channel(DESCRIPTION, STRING), description(runtime.robot)
        self._commands = None
        self._where = f"publish.{name}"
        if isinstance(section, FoxgloveInput):
            self._commands = Commands(name, section, runtime, looks)
            self._where = f"input.{name}"
        self._listener = self._commands or Looks(looks)
        self._feed = runtime.feed(
            self._where if self._commands else name, section.rates_hz(), as_cdr
        )
        self._channels: dict[str, Channel] = {
            topic: self._channel(topic, TOPICS[topic].type_name) for topic in section.topics
        }
        self._certificate, self._key = (
            None if file is None else bounded.read(runtime.beside_robot_file(file))
            for file in (section.cert_file, section.key_file)
        )

    def _channel(self, topic: str, kind: str) -> Channel:
        schema = Schema(name=kind, encoding="ros2msg", data=definition(kind).encode())
        return Channel(f"/{topic}", schema=schema, message_encoding="cdr", context=self._context)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        async with TaskGroup() as tasks:
            if self._commands is not None:
                tasks.create_task(self._commands.run())
            tasks.create_task(self._send())

    async def _send(self) -> None:
        server = await self._started()
        try:
            if self._commands is not None:
                self._commands.server = server
            async for topic, message in self._feed:
                time_ns = stamp_ns(topic.name, message)
                self._channels[topic.name].log(message, log_time=time_ns)
        finally:
            async with within(STOP_WITHIN_S):
                await asyncio.to_thread(server.stop)  # its threads may wait for this event loop

    async def _started(self) -> WebSocketServer:
        failing = False
        while True:
            try:
                return self._start()
            except (OSError, RuntimeError) as error:
                if not failing:
                    failing = True
                    _log.warning("%s: cannot listen: %s", self._where, error)
            await asyncio.sleep(LISTEN_AGAIN_S)

    def _start(self) -> WebSocketServer:
        """Start the server. Raises OSError and RuntimeError if it cannot listen."""
        obeys = self._commands is not None
        return foxglove.start_server(
            name=self._robot,
            host=self._section.host,
            port=self._section.port,
            context=self._context,
            server_listener=self._listener,
            capabilities=[Capability.ClientPublish, Capability.Parameters] if obeys else None,
            supported_encodings=[ENCODING] if obeys else None,
            services=None if self._commands is None else self._commands.services(),
            message_backlog_size=BACKLOG,
            tls_cert=self._certificate,
            tls_key=self._key,
        )
