# SPDX-License-Identifier: Apache-2.0
"""What goes over a line, for `motord trace`: the newest entries, each with its number, so that a
reader sees what it has missed."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

ENTRIES_MAX = 256


@dataclass(frozen=True, slots=True)
class TraceEntry:
    """Bytes in one direction. On CAN a whole struct can_frame or canfd_frame (linux/can.h)."""

    number: int
    stamp_ns: int
    """CLOCK_MONOTONIC."""
    outward: bool
    """To the drives."""
    data: bytes


class Trace(Protocol):
    """Of one line. Several may read; while it is off it keeps nothing."""

    def switch(self, *, on: bool) -> None: ...

    @property
    def newest(self) -> int:
        """The newest entry's number; the first is 1."""
        ...

    def after(self, number: int) -> Iterator[TraceEntry]:
        """Entries with greater numbers that were not overwritten, the oldest first."""
        ...


class PythonTrace:
    """A Trace that asyncio itself writes."""

    def __init__(self) -> None:
        self.on = False
        self.newest = 0
        self._entries: deque[TraceEntry] = deque(maxlen=ENTRIES_MAX)

    def switch(self, *, on: bool) -> None:
        self.on = on

    def put(self, stamp_ns: int, data: bytes, *, outward: bool) -> None:
        """Only while it is on; check that first, it is cheaper."""
        if self.on:
            self.newest += 1
            self._entries.append(TraceEntry(self.newest, stamp_ns, outward, data))

    def after(self, number: int) -> Iterator[TraceEntry]:
        return (entry for entry in tuple(self._entries) if entry.number > number)
