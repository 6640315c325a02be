# SPDX-License-Identifier: Apache-2.0
"""Messages in memory: those that wait for the disk, or are kept for a fault."""

from __future__ import annotations

from collections import deque

from motord.bus.mcap.files import Entry

ENTRY_BYTES = 250
"""Memory of an entry beside its data: the object, its number and its place."""


class Waiting:
    """A queue of messages, oldest first, with a limit of its bytes."""

    def __init__(self, bytes_max: int) -> None:
        self._bytes_max = bytes_max
        self._entries: deque[Entry] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._entries)

    def keep(self, entry: Entry) -> int:
        """Add the newest message; return how many of the oldest were lost for it."""
        self._entries.append(entry)
        self._bytes += _bytes(entry)
        lost = 0
        while self._bytes > self._bytes_max:
            self._drop()
            lost += 1
        return lost

    def forget(self, oldest_ns: int) -> None:
        """Drop all messages from before `oldest_ns`."""
        while self._entries and self._entries[0].log_ns < oldest_ns:
            self._drop()

    def take(self) -> list[Entry]:
        """Remove all messages and return them."""
        taken = list(self._entries)
        self._entries.clear()
        self._bytes = 0
        return taken

    def _drop(self) -> None:
        self._bytes -= _bytes(self._entries.popleft())


def _bytes(entry: Entry) -> int:
    return len(entry.data) + ENTRY_BYTES
