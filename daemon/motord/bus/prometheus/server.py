# SPDX-License-Identifier: Apache-2.0
"""Figures for Prometheus: GET /metrics, in the text format 0.0.4
(prometheus.io/docs/instrumenting/exposition_formats).

Each answer is made of the newest state at the moment of asking. Requests are bounded in length, in
time and in number; nothing is ever written back to the robot.
"""

from __future__ import annotations

import asyncio
import logging
from http import HTTPStatus
from typing import TYPE_CHECKING

from motord.api.deadline import within
from motord.bus.prometheus.metrics import exposition
from motord.config import PrometheusPublish

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
REQUEST_BYTES_MAX = 8192
REQUEST_WITHIN_S = 5.0
CONNECTIONS_MAX = 16
LISTEN_AGAIN_S = 5.0

_log = logging.getLogger(__name__)


class PrometheusServer:
    def __init__(self, name: str, section: PrometheusPublish, runtime: Runtime) -> None:
        self._name = name
        self._host, self._port = section.host, section.port
        self._runtime = runtime
        self._connections = 0
        self._failing = False

    async def run(self) -> None:
        """As Adapter.run."""
        while True:
            try:
                server = await asyncio.start_server(
                    self._attend, self._host, self._port, limit=REQUEST_BYTES_MAX
                )
            except OSError as error:
                if not self._failing:
                    self._failing = True
                    _log.warning("publish.%s: cannot listen: %s", self._name, error)
                await asyncio.sleep(LISTEN_AGAIN_S)
                continue
            self._failing = False
            async with server:
                await server.serve_forever()

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One request; the connection ends with its answer."""
        try:
            if self._connections >= CONNECTIONS_MAX:
                return
            self._connections += 1
            try:
                async with within(REQUEST_WITHIN_S):
                    head = await reader.readuntil(b"\r\n\r\n")
                    writer.write(self._answer(head))
                    await writer.drain()
            except (OSError, TimeoutError, EOFError, asyncio.LimitOverrunError):
                pass  # not a client that waits for an answer
            finally:
                self._connections -= 1
        finally:
            writer.close()

    def _answer(self, head: bytes) -> bytes:
        method, _, rest = head.partition(b" ")
        path = rest.split(b" ", 1)[0].partition(b"?")[0]
        if method not in (b"GET", b"HEAD"):
            return _response(HTTPStatus.METHOD_NOT_ALLOWED, b"GET /metrics\n")
        if path != b"/metrics":
            return _response(HTTPStatus.NOT_FOUND, b"GET /metrics\n")
        body = exposition(self._runtime.body, self._runtime.view).encode()
        return _response(HTTPStatus.OK, body, with_body=method == b"GET")


def _response(status: HTTPStatus, body: bytes, *, with_body: bool = True) -> bytes:
    head = (
        f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: {CONTENT_TYPE}\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + (body if with_body else b"")
