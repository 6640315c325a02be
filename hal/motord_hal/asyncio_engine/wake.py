# SPDX-License-Identifier: Apache-2.0
"""What does not wait for a line's next cycle: the loop wakes the line for a new set-point."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Iterator

from motord_hal.clock import now_s, within
from motord_hal.rt import Exchange

EARLY_AT_ONCE = 4
"""As csrc/pace.h: in the long run no more early cycles than others, and so many at once."""


class Wake:
    """Of one line, while `open`."""

    def __init__(self, exchange: Exchange, line: int, period_s: float) -> None:
        self._exchange, self._line, self._period_s = exchange, line, period_s
        self._woken = asyncio.Event()
        self._early_s = 0.0
        """Until then the early ones are more than their share."""

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """The loop may wake the line."""
        loop, fd = asyncio.get_running_loop(), self._exchange.line_wake_fd(self._line)

        def woken() -> None:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(fd)
            self._woken.set()

        loop.add_reader(fd, woken)
        try:
            yield
        finally:
            loop.remove_reader(fd)

    async def wait_until_s(self, until_s: float) -> bool:
        """True: the line was woken before."""
        with contextlib.suppress(TimeoutError):
            async with within(max(until_s - now_s(), 0.0)):
                await self._woken.wait()
        was = self._woken.is_set()
        self._woken.clear()
        return was

    def may_hurry(self) -> bool:
        """An early cycle is to begin: true, and it is counted."""
        now = now_s()
        if self._early_s - now > (EARLY_AT_ONCE - 1) * self._period_s:
            return False
        self._early_s = max(self._early_s, now) + self._period_s
        return True
