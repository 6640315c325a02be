# SPDX-License-Identifier: Apache-2.0
"""The notifier wakes asyncio when a line's thread has done something."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable

LOOK_EVERY_S = 0.5
"""Longest time between two reads of the report. Important changes wake asyncio before."""


class Notifier:
    """The eventfd that the thread writes to, and the tasks that wait for a condition."""

    def __init__(self) -> None:
        self.event_fd = -1
        self._called = asyncio.Event()
        self._waiting: list[tuple[Callable[[], bool], asyncio.Future[None]]] = []

    def open(self) -> None:
        self.event_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        asyncio.get_running_loop().add_reader(self.event_fd, self._take)

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self.event_fd)
        os.close(self.event_fd)
        self.event_fd = -1

    def _take(self) -> None:
        try:
            os.eventfd_read(self.event_fd)
        except BlockingIOError:
            return
        self.poke()

    def poke(self) -> None:
        """Wake the task that waits for a new report."""
        self._called.set()

    async def wait(self) -> None:
        """Wait for a new report, LOOK_EVERY_S at most."""
        timer = asyncio.get_running_loop().call_later(LOOK_EVERY_S, self.poke)
        try:
            await self._called.wait()
        finally:
            timer.cancel()
        self._called.clear()

    def looked(self) -> None:
        """Wake the tasks whose condition is now true. Call it after each new report."""
        for condition, future in self._waiting:
            if not future.done() and condition():
                future.set_result(None)
        self._waiting = [
            (condition, future) for condition, future in self._waiting if not future.done()
        ]

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until the condition holds. It is checked now and after each report."""
        while not condition():
            future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting.append((condition, future))
            await future
