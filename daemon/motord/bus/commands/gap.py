# SPDX-License-Identifier: Apache-2.0
"""Whether this process has just stood still: stopped, without a turn for long, or asleep with the
whole machine. What came meanwhile waits in some queue, and looks new when it is taken out."""

from __future__ import annotations

import asyncio
import math
import time

DRAINED_AFTER_S = 1.0
"""By then the queues are empty again."""
LOOKS_A_GAP = 4
STOOD_STILL = "motord-bus stood still for a while, so this may be old: send it again"
"""Why something is refused then."""


class Gap:
    """Looks at the clock again and again; a pause between two looks that is too long is a
    standstill. It is known to the first caller, whatever the event loop turns to first."""

    def __init__(self, longest_s: float) -> None:
        """`longest_s`: what is no gap yet. Without `watch` all is one."""
        self._longest_s = longest_s
        self._looked_s = _now_s()
        self._ended_s = -math.inf

    def just_over(self) -> bool:
        """There was one, and what comes now may have waited for its end."""
        self._look()
        return self._looked_s - self._ended_s < max(DRAINED_AFTER_S, self._longest_s)

    async def watch(self) -> None:
        """Until cancelled."""
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
    """It goes on while the machine sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)
