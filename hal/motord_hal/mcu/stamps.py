# SPDX-License-Identifier: Apache-2.0
"""The board's clock on ours: a feedback that waited in a buffer is as old as it is."""

from __future__ import annotations

from collections import deque

SAMPLES_KEPT = 32
"""The least delay of so many newest frames counts. A resonator that is 0.5 % off (the worst that
boards have) makes stamps older by 0.5 % of the time of so many frames, never newer."""
_WRAP_US = 1 << 32
NS_PER_US = 1000


class BoardClock:
    """Frame by frame: the least difference between our clock and the board's is the offset. Source
    of the rule: Cristian, Probabilistic Clock Synchronization, Distributed Computing 3, 1989."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._board_ns = 0
        self._offsets_ns: deque[int] = deque(maxlen=SAMPLES_KEPT)

    def stamp_ns(self, time_us: int, came_ns: int) -> int:
        """When a frame with the board's time `time_us` was made; never after it came."""
        if self._last_us is not None:
            self._board_ns += (time_us - self._last_us) % _WRAP_US * NS_PER_US
        self._last_us = time_us
        self._offsets_ns.append(came_ns - self._board_ns)
        return self._board_ns + min(self._offsets_ns)
