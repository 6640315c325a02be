# SPDX-License-Identifier: Apache-2.0
"""Detects that this process stood still: stopped, without a processor, or suspended with the
machine. Messages that came meanwhile have waited in queues and look new when they are read."""

from __future__ import annotations

import asyncio
import math
import time

DRAINED_AFTER_S = 1.0
"""Time after a gap until the queues are empty again."""
LOOKS_A_GAP = 4
STOOD_STILL = "motord-bus stood still for a while, so this may be old: send it again"
"""Reason for a refusal after a gap."""


class Gap:
    """Looks at the clock again and again; too long a time between two looks is a gap. The first
    caller after a gap sees it, whichever task the event loop runs first."""

    def __init__(self, longest_s: float) -> None:
        """`longest_s`: longest time between two looks that is no gap. Without `watch` every time is
        a gap."""
        self._longest_s = longest_s
        self._looked_s = _now_s()
        self._ended_s = -math.inf

    def just_over(self) -> bool:
        """Return whether a gap has just ended: what comes now may have waited for its end."""
        self._look()
        return self._looked_s - self._ended_s < max(DRAINED_AFTER_S, self._longest_s)

    async def watch(self) -> None:
        """Look at the clock until cancelled."""
        self._looked_s = _now_s()
        while True:
            self._look()
            await asyncio.sleep(self._longest_s / LOOKS_A_GAP)

    def _look(self) -> None:
        now_s = _now_s()
        if now_s - self._looked_s > self._longest_s:
            self._ended_s = now_s
        self._looked_s = now_s


def _now_s() -> float:
    """Return the time of a clock that runs on while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
