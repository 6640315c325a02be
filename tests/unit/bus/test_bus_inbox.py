# SPDX-License-Identifier: Apache-2.0
"""From threads to the event loop: messages that a thread puts in an inbox, and calls that wait."""

import asyncio
import contextlib

import pytest

from motord.bus.commands.gate import NotTaken
from motord.bus.inbox import Inbox, ThreadBridge

DEADLINE_S = 20.0


@contextlib.asynccontextmanager
async def thread_bridge():
    made = ThreadBridge()
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(made.run())
        await asyncio.sleep(0)
        try:
            yield made, running
        finally:
            running.cancel()


async def answer(value):
    await asyncio.sleep(0)
    return value


async def refuse():
    raise NotTaken("not now")


async def test_a_thread_gets_its_answer_from_the_loop():
    async with thread_bridge() as (made, _):
        asked = asyncio.to_thread(made.ask, lambda: answer(7), DEADLINE_S)
        assert await asked == 7


async def test_a_refusal_is_raised_in_the_thread():
    async with thread_bridge() as (made, _):
        with pytest.raises(NotTaken, match="not now"):
            await asyncio.to_thread(made.ask, refuse, DEADLINE_S)


async def test_a_thread_that_waits_too_long_gets_an_error():
    async with thread_bridge() as (made, _):
        with pytest.raises(NotTaken, match="no answer within"):
            await asyncio.to_thread(made.ask, asyncio.Event().wait, 0.05)


async def test_calls_that_wait_at_the_end_or_come_later_are_refused():
    begun = asyncio.Event()

    async def endless():
        begun.set()
        await asyncio.Event().wait()

    async with thread_bridge() as (made, running):
        waiting = asyncio.create_task(asyncio.to_thread(made.ask, endless, DEADLINE_S))
        async with asyncio.timeout(DEADLINE_S):
            await begun.wait()
        running.cancel()
        with pytest.raises(NotTaken, match="is ending"):
            await waiting
        with pytest.raises(NotTaken, match="is ending"):
            await asyncio.to_thread(made.ask, lambda: answer(7), DEADLINE_S)


async def test_a_full_inbox_keeps_the_newest_in_their_order():
    taken = []
    inbox = Inbox(3, taken.append)
    inbox.open()

    def put():
        for number in range(9):
            inbox.put(number)

    put()  # does not await, so the loop takes no message meanwhile
    async with asyncio.timeout(DEADLINE_S):
        while len(taken) < 3:
            await asyncio.sleep(0)
    assert taken == [6, 7, 8]
    await asyncio.to_thread(put)
    async with asyncio.timeout(DEADLINE_S):
        while taken[-1] != 8 or len(taken) < 4:
            await asyncio.sleep(0)
