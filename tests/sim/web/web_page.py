# SPDX-License-Identifier: Apache-2.0
"""Programs that use the dashboard's socket as its page does."""

import asyncio
import base64
import contextlib
import json
import socket
import struct
from pathlib import Path

import aiohttp
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, running, wait_until

TOKEN = "a-token-for-tests-0123456789"
DRIVE, ACKNOWLEDGE = 1, 2
CLOSE = aiohttp.ClientWSTimeout(ws_close=1.0)
CLOSING = {aiohttp.WSMsgType[name] for name in ("CLOSE", "CLOSING", "CLOSED", "ERROR")}


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def listens(port):
    try:
        socket.create_connection(("127.0.0.1", port), 5.0).close()
    except OSError:
        return False
    return True


def bus_children(stage, command):
    """Return the child processes of motord-bus that run this command of motord."""
    bus = stage.robot.status()["bus"]["pid"]
    children = Path(f"/proc/{bus}/task/{bus}/children").read_text(encoding="ascii").split()
    found = []
    for child in children:
        with contextlib.suppress(OSError):  # it has ended
            words = Path(f"/proc/{child}/cmdline").read_bytes().decode().split("\0")
            found += [child] if command in words else []
    return found


class Page:
    """A page's end of the dashboard's socket. It always reads, as a browser does: aiohttp answers
    pings only while its user reads, and motord-bus closes the connection of a silent page."""

    def __init__(self, connection, acknowledges):
        self.connection, self.acknowledges = connection, acknowledges
        self._messages = asyncio.Queue()

    async def read(self):
        """Keep what arrives for `receive`, up to the closing message."""
        while True:
            message = await self.connection.receive()
            self._messages.put_nowait(message)
            if message.type in CLOSING:
                return

    async def receive(self):
        """Return the next message; the last one is in CLOSING."""
        async with asyncio.timeout(DEADLINE_S):
            return await self._messages.get()

    async def until(self, wanted):
        """Call `wanted` with each message, decoded JSON or the number of a frame; return its first
        true result."""
        async with asyncio.timeout(DEADLINE_S):
            while True:
                message = await self._messages.get()
                if message.type is aiohttp.WSMsgType.BINARY:
                    if self.acknowledges:
                        arrived = bytes((ACKNOWLEDGE,)) + message.data[5:9]
                        await self.connection.send_bytes(arrived)
                    found = wanted(struct.unpack_from("<I", message.data, 5)[0])
                else:
                    assert message.type is aiohttp.WSMsgType.TEXT, message
                    found = wanted(json.loads(message.data))
                if found:
                    return found

    async def answer(self, call, **params):
        await self.connection.send_json({"id": 7, "call": call, "params": params})
        return await self.until(
            lambda one: isinstance(one, dict) and one.get("answer") == 7 and one
        )

    async def drive(self, press, linear_m_s, seen_s):
        now_ms = asyncio.get_running_loop().time() * 1e3
        command = struct.pack("<BIddddd", DRIVE, press, now_ms, seen_s, linear_m_s, 0.0, 0.0)
        await self.connection.send_bytes(command)


async def ended(page):
    """Wait until no procedure runs, which the next status shows."""

    def idle(one):
        return isinstance(one, dict) and "status" in one and one["status"]["commissioning"] is None

    await page.until(idle)


@contextlib.contextmanager
def with_dashboard(folder, port, *settings, robot=ROBOT):
    """Run a daemon whose dashboard needs TOKEN; yield its stage once the drives are idle."""
    token = folder / "token"
    token.write_text(TOKEN, encoding="utf-8")
    token.chmod(0o600)
    dashboard = (
        "input.web.kind=web", f"input.web.port={port}", f'input.web.token_file="{token}"',
    )  # fmt: skip
    with running(folder, *dashboard, *settings, robot=robot) as stage:
        stage.wait_for("idle")
        wait_until(lambda: listens(port), "the dashboard listens")
        yield stage


@contextlib.asynccontextmanager
async def pages(port):
    """Yield a function that opens connected pages; all pages are closed at the end."""
    async with aiohttp.ClientSession() as session, asyncio.TaskGroup() as readers:
        opened = []

        async def connected(token=TOKEN, acknowledges=True, **headers):
            protocols = ["motord.1"]
            if token is not None:
                coded = base64.urlsafe_b64encode(token.encode()).decode().rstrip("=")
                protocols.append(f"token.{coded}")
            address = f"http://127.0.0.1:{port}/socket"
            found = await session.ws_connect(
                address, protocols=protocols, headers=headers, timeout=CLOSE
            )
            page = Page(found, acknowledges)
            opened.append(page)
            readers.create_task(page.read())
            return page

        yield connected
        for page in opened:
            await page.connection.close()
