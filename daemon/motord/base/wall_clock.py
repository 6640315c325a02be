# SPDX-License-Identifier: Apache-2.0
"""The wall time of moments of CLOCK_MONOTONIC: one moment has one wall time in this process.

CLOCK_REALTIME and CLOCK_MONOTONIC run at the same rate, also while NTP corrects it: their offset
changes when the clock is set, and while the computer is suspended. So the offset is
measured between two reads of the monotonic clock, kept, and changed only when a measurement
contradicts it: slowly, so that stamps grow; or at once, if the clock was set."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

SET_NS = 10_000_000
"""A clock that is off by more than this was set. A smaller error is made up for slowly."""
SLEW_PPM = 500
TOLERANCE_NS = 20_000
"""A smaller error is not made up for."""
_NARROW_NS = 20_000
_TRIES = 5
_SPANS_MAX = 16

_log = logging.getLogger(__name__)


class _Span(NamedTuple):
    """The offset from a moment on."""

    begin_ns: int
    offset_ns: int
    """Offset at the beginning."""
    target_ns: int
    """Offset that is reached slowly, and then stays."""

    def at(self, stamp_ns: int) -> int:
        """Return the offset at a moment."""
        reached_ns = max(stamp_ns - self.begin_ns, 0) * SLEW_PPM // 1_000_000
        wanted_ns = self.target_ns - self.offset_ns
        return self.offset_ns + max(-reached_ns, min(reached_ns, wanted_ns))


class WallClock:
    """Converts moments of CLOCK_MONOTONIC; `look` keeps it right."""

    def __init__(
        self,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        realtime_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._monotonic_ns, self._realtime_ns = monotonic_ns, realtime_ns
        begin_ns, offset_ns, _ = self._measure()
        self._spans = deque([_Span(begin_ns, offset_ns, offset_ns)], maxlen=_SPANS_MAX)
        self.sets = 0
        """How often the clock was set."""

    def look(self) -> None:
        """Compare the offset with the clocks. Call it before new measurements are converted."""
        now_ns, offset_ns, error_ns = self._measure()
        span = self._spans[-1]
        kept_ns = span.at(now_ns)
        if abs(offset_ns - kept_ns) > error_ns + SET_NS:
            self._spans.append(_Span(now_ns, offset_ns, offset_ns))
            self.sets += 1
            text = "the clock was set, or the computer was suspended: stamps change by %+.3f s"
            _log.warning(text, (offset_ns - kept_ns) / 1e9)
        elif abs(offset_ns - span.target_ns) > error_ns + TOLERANCE_NS:
            self._spans.append(_Span(now_ns, kept_ns, offset_ns))

    def wall_ns(self, stamp_ns: int) -> int:
        """Return the wall time of a moment: always the same, as long as the clock was not set, or
        followed, many times since."""
        span = next((one for one in reversed(self._spans) if one.begin_ns <= stamp_ns), None)
        return stamp_ns + (span or self._spans[0]).at(stamp_ns)

    def now_ns(self) -> int:
        """Return the wall time of this moment, on the time line of the stamps."""
        self.look()
        return self.wall_ns(self._monotonic_ns())

    def _measure(self) -> tuple[int, int, int]:
        """Return a moment, the offset then, and its greatest error: half of the time between the
        two reads of the monotonic clock. Of several tries the best counts."""
        found: list[tuple[int, int, int]] = []
        for _ in range(_TRIES):
            before_ns = self._monotonic_ns()
            wall_ns = self._realtime_ns()
            after_ns = self._monotonic_ns()
            error_ns = (after_ns - before_ns + 1) // 2
            found.append((error_ns, after_ns, wall_ns - (before_ns + after_ns) // 2))
            if error_ns <= _NARROW_NS:
                break
        error_ns, after_ns, offset_ns = min(found)
        return after_ns, offset_ns, error_ns
