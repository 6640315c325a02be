# SPDX-License-Identifier: Apache-2.0
"""A rosbridge server: JSON over WebSocket (protocol 2.0, ROSBRIDGE_PROTOCOL.md of
RobotWebTools/rosbridge_suite). As a publisher it only tells; as an input it obeys who connected
with the token.
"""

from __future__ import annotations

import asyncio
import logging
import ssl
from contextlib import AbstractAsyncContextManager
from http import HTTPStatus
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from motord.bus.commands.gate import CommandGate, NotTaken
from motord.bus.messages.json_direct import encoder as json_encoder
from motord.bus.rosbridge.client import RosbridgeClient
from motord.config import RosbridgeInput, RosbridgeServer

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

CLIENTS_MAX = 32
STRANGERS_MAX = 32
"""Connections that have not shown what they want yet. One more, and the oldest has to go: each
costs a descriptor, and may be silent for ANSWER_WITHIN_S."""
MESSAGE_BYTES_MAX = 65536
PING_EVERY_S = 5.0
ANSWER_WITHIN_S = 5.0
LISTEN_AGAIN_S = 5.0

_log = logging.getLogger(__name__)


class RosbridgeAdapter:
    def __init__(self, name: str, section: RosbridgeServer, runtime: Runtime) -> None:
        """Raises OSError and ValueError for files that cannot be used."""
        self._section = section
        self._runtime = runtime
        self._gate = None
        table = "publish"
        if isinstance(section, RosbridgeInput):
            self._gate, table = CommandGate(name, section, runtime), "input"
        self._where = f"{table}.{name}"
        self._feed = runtime.feed(
            self._where if self._gate else name, section.rates_hz(), json_encoder
        )
        self._clients: set[RosbridgeClient] = set()
        self._strangers: dict[ServerConnection, None] = {}
        self._tls = _tls_context(section, runtime)

    async def run(self) -> None:
        """As Adapter.run."""
        async with asyncio.TaskGroup() as tasks:
            if self._gate is not None:
                tasks.create_task(self._gate.source.run())
            tasks.create_task(self._tell())
            tasks.create_task(self._serve())

    async def _serve(self) -> None:
        failing = False
        while True:
            try:
                async with self._server() as server:
                    await server.serve_forever()
            except OSError as error:
                if not failing:
                    failing = True
                    _log.warning("%s: cannot listen: %s", self._where, error)
            await asyncio.sleep(LISTEN_AGAIN_S)

    def _server(self) -> AbstractAsyncContextManager[Server]:
        return serve(
            self._attend,
            self._section.host,
            self._section.port,
            ssl=self._tls,
            process_request=self._admit,
            create_connection=_counting(self._strangers),
            compression=None,
            max_size=MESSAGE_BYTES_MAX,
            open_timeout=ANSWER_WITHIN_S,
            close_timeout=ANSWER_WITHIN_S,
            ping_interval=PING_EVERY_S,
            ping_timeout=ANSWER_WITHIN_S,
        )

    def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """None: it may connect."""
        if len(self._clients) >= CLIENTS_MAX:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients\n")
        if self._gate is not None:
            try:
                self._gate.admit(_token(request))
            except NotTaken as error:
                return connection.respond(HTTPStatus.UNAUTHORIZED, f"{error}\n")
        return None

    async def _attend(self, connection: ServerConnection) -> None:
        self._strangers.pop(connection, None)
        client = RosbridgeClient(connection, self._section.rates_hz(), self._gate)
        self._clients.add(client)
        try:
            await client.run()
        except* (ConnectionClosed, OSError):
            pass  # it went away
        finally:
            self._clients.discard(client)

    async def _tell(self) -> None:
        """Each sample is written once, whoever wants it."""
        async for sample in self._feed:
            wanting = [client for client in self._clients if client.wants(sample.topic.name)]
            if wanting:
                text = _published(sample.topic.name, sample.message)
                self._feed.dropped += sum(
                    client.offer(sample.topic.name, text) for client in wanting
                )


def _counting(strangers: dict[ServerConnection, None]) -> type[ServerConnection]:
    """Connections that are in it, the oldest first, until they are attended to or lost."""

    class Counted(ServerConnection):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            strangers[self] = None
            if len(strangers) > STRANGERS_MAX:
                oldest = next(iter(strangers))
                del strangers[oldest]
                oldest.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            strangers.pop(self, None)
            super().connection_lost(exc)

    return Counted


def _published(topic: str, message: bytes) -> str:
    return f'{{"op":"publish","topic":"/{topic}","msg":{message.decode()}}}'


def _token(request: Request) -> str | None:
    """Of the address (?token=...) or of the header "Authorization: Bearer ..."."""
    kind, _, shown = request.headers.get("Authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return shown.strip()
    return next(iter(parse_qs(urlsplit(request.path).query).get("token", ())), None)


def _tls_context(section: RosbridgeServer, runtime: Runtime) -> ssl.SSLContext | None:
    if section.cert_file is None or section.key_file is None:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    certificate, key = map(runtime.beside_robot_file, (section.cert_file, section.key_file))
    context.load_cert_chain(certificate, key)
    return context
