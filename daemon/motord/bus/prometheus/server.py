# SPDX-License-Identifier: Apache-2.0
"""Figures for Prometheus: GET /metrics, in the text format 0.0.4
(prometheus.io/docs/instrumenting/exposition_formats).

Each answer is made from the newest state at the time of the request. Nothing is ever written back
to the robot.
"""

from __future__ import annotations

from http import HTTPStatus
from typing import TYPE_CHECKING

from aiohttp import web

from motord.bus.http_server import HttpServer
from motord.bus.prometheus.metrics import exposition
from motord.config import PrometheusPublish

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class PrometheusServer:
    def __init__(self, name: str, section: PrometheusPublish, runtime: Runtime) -> None:
        self._runtime = runtime
        where = f"publish.{name}"
        self._server = HttpServer(where, section.host, section.port, self._answer)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        await self._server.run()

    async def _answer(self, request: web.BaseRequest) -> web.Response:
        if request.method not in ("GET", "HEAD"):
            return _text(HTTPStatus.METHOD_NOT_ALLOWED, b"GET /metrics\n")
        if request.path != "/metrics":
            return _text(HTTPStatus.NOT_FOUND, b"GET /metrics\n")
        return _text(HTTPStatus.OK, exposition(self._runtime.body, self._runtime.view))


def _text(status: HTTPStatus, body: bytes) -> web.Response:
    return web.Response(status=status, body=body, headers={"Content-Type": CONTENT_TYPE})
