# SPDX-License-Identifier: Apache-2.0
"""The dashboard's socket, as a program without a browser sees it."""

import asyncio
import base64
import json
import signal
import socket
import struct
import subprocess
import sys
import urllib.request

import aiohttp
import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until

TOKEN = "a-token-for-tests-0123456789"
DRIVE, ACKNOWLEDGE = 1, 2


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


@pytest.fixture(scope="module")
def port():
    return free_port()


@pytest.fixture(scope="module")
def stage(tmp_path_factory, port):
    folder = tmp_path_factory.mktemp("web")
    token = folder / "token"
    token.write_text(TOKEN, encoding="utf-8")
    token.chmod(0o600)
    settings = (
        "input.web.kind=web", f"input.web.port={port}", f'input.web.token_file="{token}"',
    )  # fmt: skip
    with running(folder, *settings) as stage:
        stage.wait_for("idle")
        wait_until(lambda: listens(port), "the dashboard listens")
        yield stage


class Page:
    """What a page does with its socket."""

    def __init__(self, connection):
        self.connection = connection

    async def until(self, wanted):
        """The first message of which `wanted` makes something: JSON as it is, a frame as its
        number."""
        async with asyncio.timeout(DEADLINE_S):
            while True:
                message = await self.connection.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
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


@pytest.fixture
async def connect(stage, port):
    async with aiohttp.ClientSession() as session:

        async def connected(token=TOKEN, **headers):
            protocols = ["motord.1"]
            if token is not None:
                protocols.append("token." + base64.urlsafe_b64encode(token.encode()).decode())
            address = f"http://127.0.0.1:{port}/socket"
            protocols = [name.rstrip("=") for name in protocols]
            return Page(await session.ws_connect(address, protocols=protocols, headers=headers))

        yield connected


def frame(one):
    """A frame's number."""
    return one if isinstance(one, int) else None


async def test_a_page_that_acknowledges_nothing_is_sent_the_newest_state_when_it_does(connect):
    page = await connect()
    await page.connection.send_json({"rate_hz": 50})
    newest = 0

    def dropped(one):
        nonlocal newest
        newest = one if isinstance(one, int) else newest
        return isinstance(one, dict) and one.get("dropped", 0) > 20

    await page.until(dropped)
    await page.connection.send_bytes(struct.pack("<BI", ACKNOWLEDGE, newest))
    assert await page.until(frame) > newest + 20


async def test_a_wrong_token_is_refused_with_a_reason_and_another_site_without(connect):
    page = await connect(token="wrong-token-0123456789")
    assert await page.connection.receive_json() == {"refused": "the token is wrong"}
    await page.connection.receive()
    assert page.connection.close_code == 4401
    with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
        await connect(Origin="https://evil.example")
    assert refused.value.status == 403


CALLS = ("arm", "estop", "params.set", "params.get", "params.save", "params.diff", "reset")


@pytest.mark.parametrize("call", CALLS)
async def test_a_page_without_the_token_can_only_look(stage, connect, call):
    page = await connect(token=None)
    assert "token" in (await page.answer(call))["error"]
    assert "result" in await page.answer("status")
    assert stage.state() == "idle"


@pytest.mark.parametrize("call", ["drive", "lease", "release", "", 7, None, ["arm"]])
async def test_a_page_calls_nothing_but_what_is_listed(connect, call):
    assert "error" in await (await connect()).answer(call)


@pytest.mark.parametrize(
    "junk", [b"", b"\x01", b"\x03\x01", b"\xff" * 45, "[]", "{", '{"rate_hz": "x"}', "{}"]
)
async def test_what_is_no_message_of_a_page_ends_nothing(connect, junk):
    page = await connect()
    send = page.connection.send_bytes if isinstance(junk, bytes) else page.connection.send_str
    await send(junk)
    assert (await page.answer("status"))["result"]["state"] == "idle"


async def test_a_page_that_shows_an_old_state_does_not_drive_and_is_given_the_reason(connect):
    page = await connect()
    await page.drive(1, 0.3, seen_s=0.0)
    why = await page.until(lambda one: isinstance(one, dict) and one.get("not_driven"))
    assert "too slow" in why


def test_the_demonstration_prints_the_address_of_its_dashboard_and_ends_with_its_signal():
    port = free_port()
    demo = subprocess.Popen(
        [sys.executable, "-m", "motord", "demo", "--web", "--port", str(port), "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=ROOT,
    )  # fmt: skip
    try:
        address = json.loads(demo.stdout.readline())["address"]
        assert address == f"http://127.0.0.1:{port}"
        with urllib.request.urlopen(f"{address}/", timeout=DEADLINE_S) as page:
            assert b"<title>motord</title>" in page.read()
            assert "default-src 'none'" in page.headers["Content-Security-Policy"]
        demo.send_signal(signal.SIGTERM)
        assert demo.wait(DEADLINE_S) == 0
        assert not listens(port)
    finally:
        demo.kill()
        demo.wait()
        demo.stdout.close()
