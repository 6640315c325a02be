# SPDX-License-Identifier: Apache-2.0
"""Groups of tasks whose members fail while their owner goes on."""

import asyncio

import pytest

from motord_hal.base.clock import within
from motord_hal.base.tasks import TaskGroup


async def fail_after(event):
    await event.wait()
    raise ValueError("a member fails")


async def a_group_fails(in_its_block):
    """Let a member fail while the block of its group runs, or while the group waits for it."""
    event = asyncio.Event()
    with pytest.raises(ExceptionGroup):
        async with TaskGroup() as tasks:
            tasks.create_task(fail_after(event))
            if in_its_block:
                event.set()
                await asyncio.Event().wait()
            asyncio.get_running_loop().call_soon(event.set)


@pytest.mark.parametrize("in_its_block", [True, False])
async def test_the_owner_of_a_failed_group_is_not_cancelled(in_its_block):
    await a_group_fails(in_its_block)
    assert asyncio.current_task().cancelling() == 0


@pytest.mark.parametrize("in_its_block", [True, False])
@pytest.mark.parametrize("limit", [asyncio.timeout, within])
async def test_a_limit_around_a_failed_group_raises_timeout_error(in_its_block, limit):
    with pytest.raises(TimeoutError):
        async with limit(0.01):
            await a_group_fails(in_its_block)
            await asyncio.Event().wait()


async def test_a_cancellation_during_the_wait_for_a_failing_member_is_kept():
    waits, reached = asyncio.Event(), []

    async def member():
        try:
            await asyncio.Event().wait()
        finally:
            raise ValueError("it fails when it is cancelled")

    async def owner():
        try:
            async with TaskGroup() as tasks:
                tasks.create_task(member())
                asyncio.get_running_loop().call_soon(waits.set)
        except* ValueError:
            reached.append(asyncio.current_task().cancelling())

    task = asyncio.create_task(owner())
    await waits.wait()
    task.cancel()
    await asyncio.wait([task])
    assert reached == [1]
