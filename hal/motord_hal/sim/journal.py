# SPDX-License-Identifier: Apache-2.0
"""Journal of a drive's real answers: the ground truth to prove that no value came from a frame that
did not answer its request."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

ENTRIES_KEPT = 50_000
"""Limit of the journal. The oldest entries are dropped first."""


@dataclass(frozen=True, slots=True)
class Entry:
    number: int
    """Number among this drive's answers with values, from 0."""
    time_s: float
    """Time when the request was over, on the rig's clock."""
    function: int
    """Modbus function or DDSM command."""
    address: int
    words: tuple[int, ...]
    """Registers from `address` on; for a DDSM reply, its bytes."""


@dataclass(slots=True)
class Journal:
    """Answers of one drive. Entries are kept only if `kept`: they cost memory."""

    kept: bool = False
    _entries: deque[Entry] = field(default_factory=lambda: deque(maxlen=ENTRIES_KEPT))
    _number: int = 0

    def add(self, time_s: float, function: int, address: int, words: tuple[int, ...]) -> None:
        if self.kept:
            entry = Entry(self._number, time_s, int(function), address, words)
            self._entries.append(entry)
            self._number += 1

    def since(self, number: int, began_ns: int, at_most: int) -> list[dict[str, Any]]:
        """Return the entries from `number` on as plain values, at most `at_most`. `began_ns` is the
        rig's zero on CLOCK_MONOTONIC."""
        chosen = [entry for entry in self._entries if entry.number >= number][:at_most]
        return [
            {
                "number": entry.number,
                "monotonic_ns": began_ns + round(entry.time_s * 1e9),
                "function": entry.function,
                "address": entry.address,
                "words": entry.words,
            }
            for entry in chosen
        ]
