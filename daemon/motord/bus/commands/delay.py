# SPDX-License-Identifier: Apache-2.0
"""How long a message was in transit, by the sender's clock, which need not be set. The time of its
fastest message is unknown and counts as zero."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

WINDOW_NS = 5_000_000_000
"""A sender whose clock was set back is not believed for this long, twice at most."""
SENDERS_MAX = 64


@dataclass(slots=True)
class _Clock:
    """The least difference of our clock to the sender's, in ns, of this window and of the one
    before it."""

    since_ns: int
    least_ns: int
    before_ns: int


class Delays:
    """Of the senders of one topic."""

    def __init__(self) -> None:
        self._clocks: OrderedDict[Hashable, _Clock] = OrderedDict()

    def waited_s(self, sender: Hashable, sent_ns: int, now_ns: int | None = None) -> float:
        """Of a message with its time of sending. `now_ns`: any clock of ours that is not set."""
        now_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) if now_ns is None else now_ns
        took_ns = now_ns - sent_ns
        clock = self._clocks.get(sender)
        if clock is None:
            clock = self._clocks[sender] = _Clock(now_ns, took_ns, took_ns)
            if len(self._clocks) > SENDERS_MAX:
                self._clocks.popitem(last=False)
        self._clocks.move_to_end(sender)
        if now_ns - clock.since_ns > WINDOW_NS:
            clock.since_ns, clock.before_ns, clock.least_ns = now_ns, clock.least_ns, took_ns
        clock.least_ns = min(clock.least_ns, took_ns)
        return (took_ns - min(clock.least_ns, clock.before_ns)) / 1e9
