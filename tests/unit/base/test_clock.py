# SPDX-License-Identifier: Apache-2.0
"""Limits on the time of waiting, also while a cancelled task cleans up."""

import asyncio

import pytest

from motord_hal.base.clock import within


async def cancelled(cleaning_up):
    """Cancel a task, which then runs `cleaning_up`, and wait for its end."""
    begun = asyncio.Event()

    async def work():
        try:
            begun.set()
            await asyncio.Event().wait()
        finally:
            await cleaning_up()

    task = asyncio.create_task(work())
    await begun.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_a_limit_raises_timeout_error_while_a_cancelled_task_cleans_up():
    """asyncio.timeout of Python 3.11.2 (Debian 12) raises CancelledError instead."""
    done = []

    async def cleaning_up():
        for name in ("first", "second"):
            try:
                async with within(0.0):
                    await asyncio.Event().wait()
            except TimeoutError:
                done.append(name)
        async with within(10.0):
            done.append("third")

    await cancelled(cleaning_up)
    assert done == ["first", "second", "third"]


async def test_a_cancellation_passes_through_a_limit():
    done = []

    async def cleaning_up():
        me = asyncio.current_task()
        asyncio.get_running_loop().call_soon(me.cancel)
        try:
            async with within(10.0):
                await asyncio.Event().wait()
        except asyncio.CancelledError:
            done.append("cancelled again")
            raise

    await cancelled(cleaning_up)
    assert done == ["cancelled again"]


async def test_a_limit_can_be_rescheduled():
    loop = asyncio.get_running_loop()
    async with within(0.0) as limit:
        limit.reschedule(loop.time() + 10.0)
        await asyncio.sleep(0.0)
    with pytest.raises(TimeoutError):
        async with within(10.0) as limit:
            limit.reschedule(loop.time())
            await asyncio.Event().wait()
