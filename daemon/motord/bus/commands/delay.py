# SPDX-License-Identifier: Apache-2.0
"""Computes how long a message was in transit, by the sender's clock, which need not be set. The
transit time of the sender's fastest message is unknown and counts as zero."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

WINDOW_NS = 5_000_000_000
"""Length of a window. A sender whose clock was set back gets wrong times for at most two
windows."""
SENDERS_MAX = 64


@dataclass(slots=True)
class _Clock:
    """The least difference of our clock to the sender's, in ns, in this window and in the one
    before it."""

    since_ns: int
    least_ns: int
    before_ns: int


class Delays:
    """Transit times of the messages of one topic, by sender."""

    def __init__(self) -> None:
        self._clocks: OrderedDict[Hashable, _Clock] = OrderedDict()

    def waited_s(self, sender: Hashable, sent_ns: int, now_ns: int | None = None) -> float:
        """Return how long a message was in transit. `sent_ns`: time of sending, by the sender's
        clock. `now_ns`: time by any clock of ours that is never set; by default CLOCK_BOOTTIME."""
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
