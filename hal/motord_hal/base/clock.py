# SPDX-License-Identifier: Apache-2.0
"""CLOCK_MONOTONIC for asyncio: the clock of the event loop, of the C core and of every stamp."""

from __future__ import annotations

import asyncio
import time
from types import TracebackType

NS_PER_S = 1_000_000_000


def now_s() -> float:
    """Return CLOCK_MONOTONIC in seconds, the clock of asyncio's timers."""
    return time.monotonic()


def now_ns() -> int:
    """Return CLOCK_MONOTONIC in nanoseconds, the clock of all stamps."""
    return time.monotonic_ns()


async def sleep_until_s(deadline_s: float) -> None:
    """Return at or after `deadline_s`, never before it; at once if it is past."""
    if (left_s := deadline_s - now_s()) > 0:
        await asyncio.sleep(left_s)


class _Within:
    """asyncio.timeout that raises TimeoutError at its end, also in a task that is cancelled."""

    __slots__ = ("_asked_before", "_limit", "_task")

    def __init__(self, limit: asyncio.Timeout) -> None:
        self._limit = limit

    async def __aenter__(self) -> asyncio.Timeout:
        task = asyncio.current_task()
        assert task is not None  # nothing else runs coroutines
        self._task, self._asked_before = task, task.cancelling()
        return await self._limit.__aenter__()

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self._limit.__aexit__(kind, error, trace)
        ours = self._limit.expired() and self._task.cancelling() <= self._asked_before
        if ours and kind is asyncio.CancelledError:
            raise TimeoutError from error


def within(limit_s: float) -> _Within:
    """Limit the time of a block like asyncio.timeout, also in a cancelled task that cleans up.
    There, until Python 3.11.3 (Debian 12 has 3.11.2), CancelledError comes out of it instead of
    TimeoutError, and the rest is left out. Source: github.com/python/cpython/issues/102780."""
    return _Within(asyncio.timeout(limit_s))
