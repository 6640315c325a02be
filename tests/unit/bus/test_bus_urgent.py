# SPDX-License-Identifier: Apache-2.0
"""A stop whose caller waits for no answer is repeated until the daemon answers."""

import asyncio
import contextlib

from motord.api.local_rpc import REFUSED, ClientError, Refused
from motord.bus.commands.urgent import Urgent

DEADLINE_S = 30.0


class Door:
    """A daemon that fails with each of `errors`, and then answers."""

    def __init__(self, *errors):
        self.errors = list(errors)
        self.calls = []
        self.answered = asyncio.Event()

    async def call(self, method, **params):
        self.calls.append(method)
        self.params = params
        if self.errors:
            raise self.errors.pop(0)
        self.answered.set()


@contextlib.asynccontextmanager
async def working(urgent):
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        task = tasks.create_task(urgent.run())
        yield
        task.cancel()


async def test_a_request_is_repeated_until_the_daemon_answers(caplog):
    door = Door(ClientError("no answer"), ClientError("no answer"))
    urgent = Urgent("pad", "estop", door.call)
    async with working(urgent):
        urgent.ask("by its button")
        await door.answered.wait()
    assert door.calls == ["estop"] * 3
    assert door.params == {"why": "input.pad: by its button"}
    assert caplog.text.count("repeated until") == 1
    assert "input.pad: estop by its button" in caplog.text


async def test_a_refused_request_is_not_repeated_and_the_next_one_is_sent(caplog):
    door = Door(Refused("not now", REFUSED))
    urgent = Urgent("pad", "stop", door.call)
    async with working(urgent):
        urgent.ask("by topic")
        while not door.calls:
            await asyncio.sleep(0)
        for _ in range(10):
            await asyncio.sleep(0)
        assert door.calls == ["stop"]
        urgent.ask("by topic")
        await door.answered.wait()
    assert door.calls == ["stop"] * 2
    assert door.params == {}
    assert "refused: not now" in caplog.text


async def test_requests_during_a_call_cause_one_more_call():
    called, go_on, calls = asyncio.Event(), asyncio.Event(), []

    async def call(method, **_):
        calls.append(method)
        called.set()
        await go_on.wait()

    urgent = Urgent("pad", "estop", call)
    async with working(urgent):
        urgent.ask("once")
        await called.wait()
        called.clear()
        for _ in range(5):
            urgent.ask("again")
        go_on.set()
        await called.wait()
    assert calls == ["estop"] * 2
