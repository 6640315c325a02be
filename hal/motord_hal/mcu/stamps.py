# SPDX-License-Identifier: Apache-2.0
"""The board's clock on ours: a feedback that waited in a buffer is as old as it is."""

from __future__ import annotations

from collections import deque

SAMPLES_KEPT = 32
"""The least delay of so many newest frames counts. A resonator that is 0.5 % off (the worst that
boards have) makes stamps older by 0.5 % of the time of so many frames, never newer."""
CATCH_UP_NS = 240_000_000
"""When the least delay falls, stamps step back. Counts of a longer way than the time since the
stamp before allows would be refused as a jump (csrc/core/odometry.c, 1.5 times the highest speed),
and the way would be lost: so a frame is no news, for so long at most, until its stamp is on by
three quarters of what the board says."""
_WRAP_US = 1 << 32
NS_PER_US = 1000


class BoardClock:
    """Frame by frame: the least difference between our clock and the board's is the offset. Source
    of the rule: Cristian, Probabilistic Clock Synchronization, Distributed Computing 3, 1989."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._board_ns = 0
        self._offsets_ns: deque[int] = deque(maxlen=SAMPLES_KEPT)
        self._given_ns = self._given_board_ns = 0
        """The newest stamp that was given, and the board's time for it."""

    def stamp_ns(self, time_us: int, came_ns: int) -> int:
        """When a frame with the board's time `time_us` was made; never after it came. Not later
        than the stamp before: it is no news, and the next one will hold what it held."""
        if self._last_us is not None:
            self._board_ns += (time_us - self._last_us) % _WRAP_US * NS_PER_US
        self._last_us = time_us
        self._offsets_ns.append(came_ns - self._board_ns)
        stamp_ns = self._board_ns + min(self._offsets_ns)
        passed_ns = self._board_ns - self._given_board_ns
        if stamp_ns - self._given_ns < 3 * passed_ns // 4 and passed_ns < CATCH_UP_NS:
            return min(self._given_ns, came_ns)
        self._given_ns, self._given_board_ns = stamp_ns, self._board_ns
        return stamp_ns
