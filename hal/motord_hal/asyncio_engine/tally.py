# SPDX-License-Identifier: Apache-2.0
"""Counters and statistics of a line's cycles and round trips."""

from __future__ import annotations

from collections import deque

from motord_hal.base.clock import now_s
from motord_hal.fieldbus.ports import RoundTrips

CYCLES_KEPT = 64
ROUND_TRIPS_KEPT = 2000


class CycleTally:
    """Number of cycles since the start, and the rate of the newest ones."""

    def __init__(self) -> None:
        self.count = 0
        self._starts_s: deque[float] = deque(maxlen=CYCLES_KEPT)

    def begin(self) -> None:
        """Count a cycle that begins now."""
        self.count += 1
        self._starts_s.append(now_s())

    @property
    def rate_hz(self) -> float:
        """Cycles a second; 0: not known yet."""
        starts = self._starts_s
        span_s = starts[-1] - starts[0] if len(starts) > 1 else 0.0
        return (len(starts) - 1) / span_s if span_s > 0 else 0.0


class RoundTripTally:
    """Durations of the newest round trips."""

    def __init__(self) -> None:
        self._trips_s: deque[float] = deque(maxlen=ROUND_TRIPS_KEPT)

    def add(self, trip_s: float) -> None:
        self._trips_s.append(trip_s)

    def percentiles(self) -> RoundTrips:
        """Return the percentiles of the round trips; zeros if there are no round trips."""
        ordered_s = sorted(self._trips_s)
        if not ordered_s:
            return RoundTrips()
        last = len(ordered_s) - 1
        p50_s, p99_s, max_s = (ordered_s[round(last * part)] for part in (0.5, 0.99, 1.0))
        return RoundTrips(p50_us=p50_s * 1e6, p99_us=p99_s * 1e6, max_us=max_s * 1e6)
