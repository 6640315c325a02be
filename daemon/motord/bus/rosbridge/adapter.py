# SPDX-License-Identifier: Apache-2.0
"""A rosbridge server: JSON over WebSocket (protocol 2.0, ROSBRIDGE_PROTOCOL.md of
RobotWebTools/rosbridge_suite). As a publisher it only sends; as an input it takes commands from
clients that connected with the token."""

from __future__ import annotations

from http import HTTPStatus
from typing import TYPE_CHECKING

from aiohttp import web

from motord.bus.commands.gate import CommandGate, NotTaken
from motord.bus.http_server import HttpServer, tls_context
from motord.bus.messages.forms import as_json
from motord.bus.rosbridge.client import RosbridgeClient
from motord.config import RosbridgeInput, RosbridgeServer
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

CLIENTS_MAX = 32
MESSAGE_BYTES_MAX = 65536
PING_EVERY_S = 10.0
"""Time between two pings. A client that does not answer within half of it counts as gone."""
CLOSE_WITHIN_S = 5.0


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
        self._feed = runtime.feed(self._where if self._gate else name, section.rates_hz(), as_json)
        self._clients: set[RosbridgeClient] = set()
        tls = tls_context(section.cert_file, section.key_file, runtime.beside_robot_file)
        self._server = HttpServer(self._where, section.host, section.port, self._answer, tls)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        async with TaskGroup() as tasks:
            if self._gate is not None:
                tasks.create_task(self._gate.source.run())
            tasks.create_task(self._send())
            tasks.create_task(self._server.run())

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        connection = web.WebSocketResponse(
            heartbeat=PING_EVERY_S, timeout=CLOSE_WITHIN_S, max_msg_size=MESSAGE_BYTES_MAX,
            compress=False,
        )  # fmt: skip
        if (refusal := self._refusal(request, connection)) is not None:
            return refusal
        await connection.prepare(request)
        client = RosbridgeClient(connection, self._section.rates_hz(), self._gate)
        self._clients.add(client)
        try:
            await client.run()
        except* OSError:
            pass  # it went away
        finally:
            self._clients.discard(client)
        return connection

    def _refusal(
        self, request: web.BaseRequest, connection: web.WebSocketResponse
    ) -> web.Response | None:
        """Return the refusal of a request; None: the client may connect."""
        if len(self._clients) >= CLIENTS_MAX:
            return web.Response(status=HTTPStatus.SERVICE_UNAVAILABLE, text="too many clients\n")
        if self._gate is not None:
            try:
                self._gate.admit(_token(request))
            except NotTaken as error:
                return web.Response(status=HTTPStatus.UNAUTHORIZED, text=f"{error}\n")
        if not connection.can_prepare(request).ok:
            return web.Response(status=HTTPStatus.UPGRADE_REQUIRED, text="a WebSocket, please\n")
        return None

    async def _send(self) -> None:
        """Send the feed's messages; each is encoded once for all clients."""
        async for topic, message in self._feed:
            wanting = [client for client in self._clients if client.wants(topic.name)]
            if wanting:
                text = _published(topic.name, message)
                self._feed.dropped += sum(client.offer(topic.name, text) for client in wanting)


def _published(topic: str, message: bytes) -> str:
    return f'{{"op":"publish","topic":"/{topic}","msg":{message.decode()}}}'


def _token(request: web.BaseRequest) -> str | None:
    """Return the token in the address (?token=...) or in the header "Authorization: Bearer ...";
    None: no token."""
    kind, _, shown = request.headers.get("Authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return shown.strip()
    return request.query.get("token")
