# SPDX-License-Identifier: Apache-2.0
"""CLOCK_MONOTONIC for asyncio: the clock of the event loop, of the C core and of every stamp."""

from __future__ import annotations

import asyncio
import time

NS_PER_S = 1_000_000_000


def now_s() -> float:
    """CLOCK_MONOTONIC in seconds: what asyncio's own timers run on."""
    return time.monotonic()


def now_ns() -> int:
    """CLOCK_MONOTONIC in nanoseconds: what stamps are made of."""
    return time.monotonic_ns()


async def sleep_until_s(deadline_s: float) -> None:
    """Return at or after `deadline_s`, never before it; at once when it is past."""
    if (left_s := deadline_s - now_s()) > 0:
        await asyncio.sleep(left_s)
