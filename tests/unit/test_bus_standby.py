# SPDX-License-Identifier: Apache-2.0
"""Who has no descriptor left can still have the robot stopped."""

import asyncio
import contextlib
import json
import os
import resource
from pathlib import Path

import pytest

from motord.bus import link
from motord.bus.link import Standby
from motord.bus.station import TO_REST, Station
from motord.client import ClientError, Refused
from motord.config import load_robot

DEMO = Path(__file__).resolve().parents[2] / "config/robots/demo.toml"
DEADLINE_S = 30.0
FILES_MAX = 256


class Daemon:
    """Its socket: answers each line with the method, but for those it was told to answer else."""

    def __init__(self, path):
        self.path, self.answers, self.peers = path, {}, set()

    async def attend(self, reader, writer):
        self.peers.add(writer)
        try:
            while line := await reader.readline():
                method = json.loads(line)["method"]
                answer = self.answers.get(method, {"result": {"state": method}})
                if answer is not None:
                    writer.write(json.dumps(answer).encode() + b"\n")
        finally:
            self.peers.discard(writer)
            writer.close()

    async def there(self):
        return await asyncio.start_unix_server(self.attend, str(self.path))

    def hang_up(self):
        for peer in self.peers:
            peer.close()


@contextlib.asynccontextmanager
async def running(*works):
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        started = [tasks.create_task(work()) for work in works]
        yield
        for task in started:
            task.cancel()


async def until(true):
    while not true():
        await asyncio.sleep(0.01)


@contextlib.contextmanager
def no_descriptor_left():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (FILES_MAX, hard))
    taken = []
    try:
        with contextlib.suppress(OSError):
            while True:
                taken.append(os.open("/dev/null", os.O_RDONLY))
        yield
    finally:
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture
def daemon(tmp_path, monkeypatch):
    monkeypatch.setattr(link, "STANDBY_AGAIN_S", 0.01)
    return Daemon(tmp_path / "sock")


async def test_without_a_descriptor_it_is_stopped_all_the_same(daemon):
    station = Station(load_robot(DEMO), daemon.path)
    async with await daemon.there(), running(station.run):
        await until(lambda: all(one.ready for one in station._standby.values()))
        with no_descriptor_left():
            for method in TO_REST * 2:
                assert (await station.call(method))["state"] == method
            with pytest.raises(ClientError, match="Too many open files"):
                await station.call("arm")


async def test_a_connection_that_was_lost_is_made_again(daemon):
    standby = Standby(daemon.path, "estop")
    async with await daemon.there(), running(standby.run):
        for _ in range(2):
            await until(lambda: standby.ready)
            assert (await standby.call())["state"] == "estop"
            daemon.hang_up()
            await until(lambda: not standby.ready)


async def test_a_refusal_is_an_answer(daemon):
    daemon.answers["stop"] = {"error": {"code": -32000, "message": "not now"}}
    standby = Standby(daemon.path, "stop")
    async with await daemon.there(), running(standby.run):
        await until(lambda: standby.ready)
        line = standby._line
        for _ in range(2):
            with pytest.raises(Refused, match="not now"):
                await standby.call()
        assert standby._line is line


async def test_an_answer_that_did_not_come_in_time_is_not_that_of_the_next_call(
    daemon, monkeypatch
):
    daemon.answers["stop"] = None
    standby = Standby(daemon.path, "stop")
    async with await daemon.there(), running(standby.run):
        await until(lambda: standby.ready)
        line = standby._line
        with monkeypatch.context() as patch:
            patch.setattr(link, "CALL_WITHIN_S", 0.05)
            with pytest.raises(ClientError, match="no answer within"):
                await standby.call()
        await until(lambda: standby._line not in (line, None))
        del daemon.answers["stop"]
        assert (await standby.call())["state"] == "stop"


async def test_nobody_there_is_said_as_for_every_call(daemon):
    station = Station(load_robot(DEMO), daemon.path)
    with pytest.raises(ClientError, match="No such file"):
        await station.call("estop")
