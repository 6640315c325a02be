# SPDX-License-Identifier: Apache-2.0
"""A port of the second process that serves HTTP: figures and WebSockets, by aiohttp.

A client that has connected and sent no request yet is a stranger. There are at most STRANGERS_MAX
strangers, each for at most ANSWER_WITHIN_S. A connection that is no WebSocket ends after its
answer. If its client takes nothing of the answer for STANDS_MAX_S, the connection is cut off; so is
a WebSocket that has ended."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.web_protocol import RequestHandler

from motord_hal.base.bounded import regular

STRANGERS_MAX = 32
"""With one more stranger the oldest is dropped: each costs a descriptor."""
ANSWER_WITHIN_S = 5.0
STANDS_MAX_S = 30.0
LISTEN_AGAIN_S = 5.0
UNSENT_BYTES_MAX = 64 * 1024
"""Largest number of bytes that the kernel keeps for a client that does not read. Without a limit
it keeps megabytes of old states, which the client reads before the newest one."""
_ACKNOWLEDGED = struct.Struct("120x Q")
"""tcpi_bytes_acked of struct tcp_info: include/uapi/linux/tcp.h, since Linux 4.1."""

Answer = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]

_log = logging.getLogger(__name__)


class _OurOwn(logging.Filter):
    """Drops log records about data that is no HTTP request. aiohttp logs it with a traceback: a
    stranger could fill the journal."""

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        return not isinstance(error, HttpProcessingError)


_requests_log = logging.getLogger(f"{__name__}.requests")
_requests_log.addFilter(_OurOwn())


def tls_context(
    cert_file: str | None, key_file: str | None, place: Callable[[str], Path]
) -> ssl.SSLContext | None:
    """Return the TLS context of a server; None: without TLS. `place` returns the path of a file by
    its name. Raises OSError for files that cannot be used."""
    if cert_file is None or key_file is None:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(regular(place(cert_file)), regular(place(key_file)))
    return context


class HttpServer:
    """An HTTP server. `where`: the table of the robot file, for the log. `answer` is called for
    each request, in a task of its own."""

    def __init__(
        self, where: str, host: str, port: int, answer: Answer, tls: ssl.SSLContext | None = None
    ) -> None:
        self._where = where
        self._host, self._port = host, port
        self._answer = answer
        self._tls = tls

    async def run(self) -> None:
        """Listen until cancelled; try again and again while the port is taken."""
        failing = False
        while True:
            protocols = _Protocols(self._answered)
            try:
                server = await self._listen(protocols)
            except OSError as error:
                if not failing:
                    failing = True
                    _log.warning("%s: cannot listen: %s", self._where, error)
                await asyncio.sleep(LISTEN_AGAIN_S)
                continue
            try:
                await asyncio.get_running_loop().create_future()
            finally:
                server.close()
                protocols.end()

    async def _listen(self, protocols: _Protocols) -> asyncio.Server:
        within_s = ANSWER_WITHIN_S if self._tls else None
        return await asyncio.get_running_loop().create_server(
            protocols, self._host, self._port, ssl=self._tls, ssl_handshake_timeout=within_s
        )

    async def _answered(self, request: web.BaseRequest) -> web.StreamResponse:
        response = await self._answer(request)
        if not isinstance(response, web.WebSocketResponse):
            response.force_close()
        return response


class _Protocols(web.Server):
    """Creates a protocol for each connection, and keeps the strangers among them, oldest first."""

    def __init__(self, answer: Answer) -> None:
        super().__init__(
            self._known, access_log=None, logger=_requests_log, lingering_time=0.0,
            keepalive_timeout=ANSWER_WITHIN_S,
        )  # fmt: skip
        self._asked = answer
        self._strangers: dict[RequestHandler, asyncio.Transport] = {}
        self._watches: dict[RequestHandler, asyncio.TimerHandle] = {}

    def connection_made(self, handler: RequestHandler, transport: asyncio.Transport) -> None:
        super().connection_made(handler, transport)
        accepted = transport.get_extra_info("socket")
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES_MAX)
        self._strangers[handler] = transport
        asyncio.get_running_loop().call_later(ANSWER_WITHIN_S, self._drop, handler)
        if len(self._strangers) > STRANGERS_MAX:
            self._drop(next(iter(self._strangers)))

    def connection_lost(self, handler: RequestHandler, exc: BaseException | None = None) -> None:
        self._strangers.pop(handler, None)
        if (watch := self._watches.pop(handler, None)) is not None:
            watch.cancel()
        super().connection_lost(handler, exc)

    def end(self) -> None:
        """End all connections at once."""
        for handler in self.connections:
            if handler.transport is not None:
                handler.transport.abort()

    def _drop(self, handler: RequestHandler) -> None:
        """Close the connection if it is still a stranger's."""
        if (transport := self._strangers.pop(handler, None)) is not None:
            transport.abort()

    async def _known(self, request: web.BaseRequest) -> web.StreamResponse:
        self._strangers.pop(request.protocol, None)
        try:
            return await self._asked(request)
        finally:
            self._watch(request.protocol, None)

    def _watch(self, handler: RequestHandler, before: tuple[int, int] | None) -> None:
        """Cut the connection off if it makes no progress, and look again later until it has ended.
        `before`: its progress at the last look; None at the first."""
        transport = handler.transport
        if transport is None:  # it has ended
            return
        now = progress(transport)
        if now == before:
            # Not transport.abort(): it would leave a task that sends a file waiting for ever.
            with contextlib.suppress(OSError):
                transport.get_extra_info("socket").shutdown(socket.SHUT_RDWR)
        later = asyncio.get_running_loop().call_later
        self._watches[handler] = later(STANDS_MAX_S, self._watch, handler, now)


def progress(transport: asyncio.Transport) -> tuple[int, int]:
    """Return figures that change while a client takes what it is sent: bytes that wait here, and
    bytes that it has acknowledged, because the kernel sends files without the transport."""
    try:
        info = transport.get_extra_info("socket").getsockopt(
            socket.IPPROTO_TCP, socket.TCP_INFO, _ACKNOWLEDGED.size
        )
        acknowledged: int = _ACKNOWLEDGED.unpack(info)[0]
    except (AttributeError, OSError, struct.error):  # it has ended, or an older kernel
        acknowledged = 0
    return transport.get_write_buffer_size(), acknowledged
