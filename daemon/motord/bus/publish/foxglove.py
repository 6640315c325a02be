# SPDX-License-Identifier: Apache-2.0
"""A live view for Foxglove: its own WebSocket server (foxglove-sdk), ROS 2's types and encoding.

The SDK's threads serve the clients; for one that is slow they drop messages.
"""

from __future__ import annotations

import asyncio
import logging
import time
from typing import TYPE_CHECKING

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.websocket import ChannelView, Client, ServerListener, WebSocketServer

from motord.bus.ros2.direct import encoder, stamp_ns
from motord.bus.ros2.types import definition
from motord.bus.ros2.urdf import DESCRIPTION, STRING, description
from motord.bus.topics import TOPICS
from motord.config import FoxglovePublish

if TYPE_CHECKING:
    from motord.bus.station import Station

LISTEN_AGAIN_S = 5.0
BACKLOG = 64
"""Messages that wait for one client at most."""

_log = logging.getLogger(__name__)


class _Looks(ServerListener):
    """What the robot looks like, for each who begins to read it. Called by threads of the SDK."""

    def __init__(self, channel: Channel, message: bytes) -> None:
        self._channel = channel
        self._message = message

    def on_subscribe(
        self,
        client: Client,  # noqa: ARG002  # the SDK's signature
        channel: ChannelView,
    ) -> None:
        if channel.id == self._channel.id():
            self._channel.log(self._message, log_time=time.time_ns())


class FoxgloveServer:
    def __init__(self, name: str, section: FoxglovePublish, station: Station) -> None:
        """Raises OSError for a certificate that cannot be read."""
        self._name = name
        self._section = section
        self._robot = station.body.robot
        self._feed = station.feed(name, section.rates_hz(), encoder)
        self._context = Context()
        self._channels: dict[str, Channel] = {
            topic: self._channel(topic, TOPICS[topic].type_name) for topic in section.topics
        }
        self._looks = _Looks(self._channel(DESCRIPTION, STRING), description(station.robot))
        self._certificate, self._key = (
            None if file is None else station.beside_robot_file(file).read_bytes()
            for file in (section.cert_file, section.key_file)
        )

    def _channel(self, topic: str, kind: str) -> Channel:
        schema = Schema(name=kind, encoding="ros2msg", data=definition(kind).encode())
        return Channel(f"/{topic}", schema=schema, message_encoding="cdr", context=self._context)

    async def run(self) -> None:
        """As Adapter.run."""
        server = await self._started()
        try:
            async for sample in self._feed:
                topic = sample.topic.name
                self._channels[topic].log(sample.message, log_time=stamp_ns(topic, sample.message))
        finally:
            server.stop()

    async def _started(self) -> WebSocketServer:
        failing = False
        while True:
            try:
                return foxglove.start_server(
                    name=self._robot,
                    host=self._section.host,
                    port=self._section.port,
                    context=self._context,
                    server_listener=self._looks,
                    message_backlog_size=BACKLOG,
                    tls_cert=self._certificate,
                    tls_key=self._key,
                )
            except (OSError, RuntimeError) as error:
                if not failing:
                    failing = True
                    _log.warning("publish.%s: cannot listen: %s", self._name, error)
            await asyncio.sleep(LISTEN_AGAIN_S)
