# SPDX-License-Identifier: Apache-2.0
"""The second process's HTTP port, which no client can fill."""

import asyncio
import contextlib
import os
import socket

import pytest
from aiohttp import ClientSession, web

from motord.bus import http_server
from motord.bus.http_server import HttpServer

DEADLINE_S = 60.0
LARGE_BYTES = 8_000_000
FILES = {}


async def greet(request):
    if request.path == "/broken":
        raise LookupError("no such figure")
    if request.path == "/large":
        return web.Response(body=bytes(LARGE_BYTES))
    if request.path == "/file":
        return web.FileResponse(FILES["large"])  # the kernel sends it (sendfile)
    return web.Response(text=f"hello {request.path}")


@pytest.fixture
def large_file(tmp_path):
    FILES["large"] = tmp_path / "large"
    FILES["large"].write_bytes(bytes(LARGE_BYTES))
    yield
    FILES.clear()


@pytest.fixture
async def port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        number = probe.getsockname()[1]
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        serving = tasks.create_task(HttpServer("publish.test", "127.0.0.1", number, greet).run())
        while True:
            with contextlib.suppress(ConnectionRefusedError):
                (await connection(number))[1].close()
                break
            await asyncio.sleep(0.01)
        yield number
        serving.cancel()


async def connection(port):
    return await asyncio.open_connection("127.0.0.1", port)


async def asked(port, path):
    async with ClientSession() as client, client.get(f"http://127.0.0.1:{port}{path}") as answer:
        return answer.status, await answer.text()


async def test_a_request_is_answered_and_the_connection_ends_with_it(port):
    reader, writer = await connection(port)
    writer.write(b"GET /a HTTP/1.1\r\nHost: x\r\n\r\n")
    answer = await reader.read()
    assert answer.startswith(b"HTTP/1.1 200 OK")
    assert answer.endswith(b"hello /a")
    writer.close()


async def test_a_request_that_fails_ends_no_other_and_is_reported(port, caplog):
    assert (await asked(port, "/broken"))[0] == 500
    assert "LookupError: no such figure" in caplog.text
    assert await asked(port, "/b") == (200, "hello /b")


@pytest.mark.parametrize("junk", [b"\x16\x03\x01\x00\xa5", b"GET\r\n\r\n", b"{}\n" * 50000])
async def test_an_invalid_request_is_closed_and_fills_no_log(port, caplog, junk):
    for _ in range(3):
        reader, writer = await connection(port)
        with contextlib.suppress(ConnectionError):
            writer.write(junk)
            writer.write_eof()
            await reader.read()
        writer.close()
    assert await asked(port, "/c") == (200, "hello /c")
    assert caplog.text == ""


async def test_a_connection_without_a_request_is_closed_in_time(monkeypatch, port):
    monkeypatch.setattr(http_server, "ANSWER_WITHIN_S", 0.1)
    reader, writer = await connection(port)
    with contextlib.suppress(ConnectionError):
        assert await reader.read() == b""
    writer.close()


async def test_the_oldest_of_too_many_idle_connections_makes_room(monkeypatch, port):
    monkeypatch.setattr(http_server, "ANSWER_WITHIN_S", 3600.0)
    strangers = [await connection(port) for _ in range(http_server.STRANGERS_MAX + 3)]
    for reader, _ in strangers[:3]:
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
    assert await asked(port, "/d") == (200, "hello /d")
    for _, writer in strangers:
        writer.close()


@contextlib.contextmanager
def asking(port, path, received_bytes):
    """Yield a client that has sent a request; its socket buffers about `received_bytes`."""
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, received_bytes)
        client.connect(("127.0.0.1", port))
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
        client.settimeout(0)
        yield client


def descriptors():
    return len(os.listdir("/proc/self/fd"))


async def until(condition):
    async with asyncio.timeout(DEADLINE_S):
        while not condition():
            await asyncio.sleep(0.01)


def answered(client):
    with contextlib.suppress(BlockingIOError):
        return client.recv(1, socket.MSG_PEEK)
    return b""


@pytest.mark.usefixtures("large_file")
@pytest.mark.parametrize("path", ["/large", "/file"])
async def test_a_client_that_does_not_read_its_answer_keeps_no_descriptor(monkeypatch, port, path):
    monkeypatch.setattr(http_server, "STANDS_MAX_S", 0.05)
    assert (await asked(port, "/a"))[0] == 200
    before = descriptors()
    with asking(port, path, 4096) as client:
        await until(lambda: answered(client))
        await until(lambda: descriptors() == before + 1)  # only the client's own is left
    assert (await asked(port, "/b"))[0] == 200


@pytest.mark.usefixtures("large_file")
@pytest.mark.parametrize("path", ["/large", "/file"])
async def test_a_client_that_reads_slowly_gets_its_whole_answer(monkeypatch, port, path):
    monkeypatch.setattr(http_server, "STANDS_MAX_S", 0.2)
    taken = 0
    with asking(port, path, 1 << 18) as client:
        while taken < LARGE_BYTES:  # takes many times STANDS_MAX_S
            await asyncio.sleep(0.01)
            with contextlib.suppress(BlockingIOError):
                found = client.recv(1 << 16)
                assert found
                taken += len(found)
