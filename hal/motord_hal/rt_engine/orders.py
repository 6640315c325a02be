# SPDX-License-Identifier: Apache-2.0
"""Jobs of a drive whose requests are orders to the thread in C, sent beside the cycle."""

from __future__ import annotations

import abc
import asyncio
import contextlib

from motord_hal.base.clock import now_s
from motord_hal.base.errors import HalError
from motord_hal.realtime.thread import LineThreadHandle, OrderedDriveReport

ORDER_WITHIN_S = 0.5
"""Longest time that an order may wait while the medium takes nothing."""
SEEN_WITHIN_S = 1.0
ARM = "arm"
"""Name of the job that arms a drive. Once the drive was sent a stop, the thread sends no order of
this job any more."""


class OrderJobs(abc.ABC):
    """Runs the jobs of a drive one at a time; an urgent job does not wait for the others."""

    def __init__(self, index: int, name: str, thread: LineThreadHandle, cycle_s: float) -> None:
        """`index` is the drive's number in the line's table."""
        self._index = index
        self._name = name
        self._handle = thread
        self._cycle_s = cycle_s
        self._turn = asyncio.Lock()

    @abc.abstractmethod
    def _drive_report(self) -> OrderedDriveReport:
        """Read the newest report of the drive."""

    @abc.abstractmethod
    def _ordered(self) -> int:
        """Return the number of orders passed to the thread since its start."""

    @property
    def request_limit_s(self) -> float:
        """Longest time until an order is sent or dropped."""
        return self._cycle_s + ORDER_WITHIN_S

    def _in_turn(self, *, urgent: bool) -> contextlib.AbstractAsyncContextManager[None]:
        return contextlib.nullcontext() if urgent else self._turn

    async def _all_sent(self, dropped_before: int) -> bool:
        """Wait until the thread has sent all orders. False: some were dropped, or time is up."""
        until_s = now_s() + self.request_limit_s + SEEN_WITHIN_S
        while now_s() < until_s:
            await asyncio.sleep(self._cycle_s)
            report = self._drive_report()
            if report.orders_dropped != dropped_before:
                break
            if report.orders_sent + report.orders_dropped == self._ordered():
                return True
        return False

    async def _stops(self) -> int:
        """Return how often C has stopped the drive, after it has seen all mode requests so far.
        Raise HalError if the thread does not see them in time."""
        requested = self._handle.requested(self._index)
        until_s = now_s() + SEEN_WITHIN_S
        while now_s() < until_s:
            report = self._drive_report()
            if report.request_seen == requested:
                return report.stops
            await asyncio.sleep(self._cycle_s)
        raise HalError(f"{self._name}: the line's thread does not answer")
