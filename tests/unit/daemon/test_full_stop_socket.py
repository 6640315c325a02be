# SPDX-License-Identifier: Apache-2.0
"""A stop whose socket is full at first: each client tries again until the loop has made room."""

import asyncio
import contextlib
import socket
import time
from types import SimpleNamespace

import pytest

from motord import aio
from motord.api import stop_request
from motord.bus.commands import link


@pytest.fixture
def path(tmp_path):
    return tmp_path / "motord.sock"


@pytest.fixture
def loop_side(path):
    """The socket that the real-time loop reads, filled with "disarm" requests."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as receiver:
        receiver.bind(str(stop_request.stop_socket(path)))
        with stop_request.open_sender() as sender:
            while stop_request.try_send(sender, path, "disarm"):
                pass
        yield receiver


def received(receiver):
    """Read all stops that wait in the socket; return their kinds, the oldest first."""
    kinds = []
    with contextlib.suppress(BlockingIOError):
        while True:
            data = receiver.recv(64)
            kinds += [kind for kind in stop_request.KINDS if stop_request.datagram(kind) == data]
    return kinds


def test_a_stop_arrives_once_the_loop_has_made_room(path, loop_side, monkeypatch):
    before = []

    def pause(_seconds):
        before.extend(received(loop_side))

    monkeypatch.setattr(
        stop_request, "time", SimpleNamespace(monotonic=time.monotonic, sleep=pause)
    )
    stop_request.send(path, "estop", 60.0)
    assert before
    assert set(before) == {"disarm"}
    assert received(loop_side) == ["estop"]


def test_a_stop_that_finds_no_room_in_time_is_an_error(path, loop_side):
    with pytest.raises(TimeoutError, match="the receive queue stays full"):
        stop_request.send(path, "estop", 0.01)
    assert "estop" not in received(loop_side)


async def bus_stop(path):
    sender = link.StopSender(path)
    with sender.open():
        assert await sender.send("estop")


async def client_stop(path):
    with stop_request.open_sender() as sender:
        assert await aio.send_stop(sender, path, "estop")


@pytest.mark.parametrize("send", [client_stop, bus_stop])
async def test_in_asyncio_a_stop_arrives_once_the_loop_has_made_room(path, loop_side, send):
    async with asyncio.timeout(60.0), asyncio.TaskGroup() as group:
        sending = group.create_task(send(path))
        for _ in range(3):  # after these turns the first try has failed, and the sender waits
            await asyncio.sleep(0)
        assert not sending.done()
        assert set(received(loop_side)) == {"disarm"}
    assert received(loop_side) == ["estop"]
