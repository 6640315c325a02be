# SPDX-License-Identifier: Apache-2.0
"""A page whose call this machine cannot carry out gets the reason and stays connected."""

import asyncio
import errno
import os

from aiohttp import ClientSession, UnixConnector, web

from motord.bus.web.processes.commissioning import Commissioning
from motord.bus.web.viewer import Viewer


async def served(path, serve):
    """Serve a page's connection at `path`; the function `serve` answers the page's calls."""

    async def answer(request):
        connection = web.WebSocketResponse()
        await connection.prepare(request)
        commissioning = Commissioning(path, lambda: None, lambda _text: None)
        await Viewer(connection, "page 1", 20.0, None, commissioning, serve).run()
        return connection

    runner = web.ServerRunner(web.Server(answer))
    await runner.setup()
    await web.UnixSite(runner, str(path)).start()
    return runner


async def test_a_call_that_the_system_refuses_is_answered_and_ends_no_connection(tmp_path):
    async def serve(_viewer, method, _params):
        if method == "recordings":
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return method

    runner = await served(tmp_path / "page", serve)
    connector = UnixConnector(path=str(tmp_path / "page"))
    async with (
        asyncio.timeout(60),
        ClientSession(connector=connector) as client,
        client.ws_connect("http://robot/") as page,
    ):
        await page.send_json({"id": 1, "call": "recordings"})
        why = f"the robot's computer: {os.strerror(errno.EMFILE)}"
        assert await page.receive_json() == {"answer": 1, "error": why}
        await page.send_json({"id": 2, "call": "status"})
        assert await page.receive_json() == {"answer": 2, "result": "status"}
    await runner.cleanup()
