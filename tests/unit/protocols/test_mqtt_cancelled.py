# SPDX-License-Identifier: Apache-2.0
"""A cancellation that aiomqtt drops still ends the task of motord-bus with the broker."""

import asyncio

from motord.bus.mqtt.connection import taken

DEADLINE_S = 20.0


async def answered(answer):
    """Wait like asyncio.wait_for before Python 3.12, which drops a cancellation after an answer."""
    try:
        await answer
    except asyncio.CancelledError:
        assert answer.done()


async def test_a_cancellation_that_meets_an_answer_ends_the_task():
    answer, went_on = asyncio.get_running_loop().create_future(), []

    async def publish():
        await taken(answered(answer))
        went_on.append(True)

    task = asyncio.ensure_future(publish())
    await asyncio.sleep(0)
    answer.set_result(None)
    task.cancel()
    await asyncio.wait({task}, timeout=DEADLINE_S)
    assert task.cancelled()
    assert went_on == []


async def test_a_call_that_nothing_cancels_goes_on():
    answer = asyncio.get_running_loop().create_future()
    answer.set_result(None)
    await taken(answered(answer))
