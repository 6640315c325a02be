# SPDX-License-Identifier: Apache-2.0
"""The newest bytes that a line sent and received, for `motord trace`. Each entry has a number, so
that a reader sees what it has missed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

ENTRIES_MAX = 256


@dataclass(frozen=True, slots=True)
class TraceEntry:
    """Bytes that went in one direction. On CAN, `data` is a whole struct can_frame or canfd_frame
    (linux/can.h)."""

    number: int
    stamp_ns: int
    """Time at which the bytes were sent or received, CLOCK_MONOTONIC."""
    outward: bool
    """True: sent to the drives; False: received from them."""
    data: bytes


class Trace(Protocol):
    """The trace of one line. Several programs may read it; while it is off it keeps nothing."""

    def switch(self, *, on: bool) -> None: ...

    @property
    def newest(self) -> int:
        """Number of the newest entry; the first entry is 1, and 0 means that there was no entry."""
        ...

    def after(self, number: int) -> Iterator[TraceEntry]:
        """Yield the entries with greater numbers that were not overwritten, the oldest first."""
        ...


class PythonTrace:
    """A Trace of a line in asyncio, which writes it."""

    def __init__(self) -> None:
        self.on = False
        self.newest = 0
        self._entries: deque[TraceEntry] = deque(maxlen=ENTRIES_MAX)

    def switch(self, *, on: bool) -> None:
        self.on = on

    def put(self, stamp_ns: int, data: bytes, *, outward: bool) -> None:
        """Add an entry if the trace is on. To save time, check `on` before the call."""
        if self.on:
            self.newest += 1
            self._entries.append(TraceEntry(self.newest, stamp_ns, outward, data))

    def after(self, number: int) -> Iterator[TraceEntry]:
        return (entry for entry in tuple(self._entries) if entry.number > number)
