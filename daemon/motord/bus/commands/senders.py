# SPDX-License-Identifier: Apache-2.0
"""The senders of one input. All of them share its lease; the daemon holds each by its number
(csrc/loop/command/holds.c), so that a zero of one does not let another go on after a stop."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

from motord.api.commands import SENDER_UNNAMED, SENDERS_NAMED

KEPT_S = 600.0
"""Time after its newest command for which a sender keeps its number."""
PLACES = SENDERS_NAMED[: len(SENDERS_NAMED) // 2]
"""Numbers that this process gives. A receiver in C has the others: OUTLET_SENDERS_FROM of
csrc/bus/bus.h."""


@dataclass(frozen=True, slots=True)
class Sender:
    """The sender of a command."""

    name: str = ""
    """For the log; empty: not known."""
    key: Hashable = None
    """Identifies it; None: the input cannot distinguish its senders."""


UNKNOWN = Sender()


class Senders:
    """Numbers the senders of one input."""

    def __init__(self) -> None:
        self._known: OrderedDict[Hashable, tuple[int, float]] = OrderedDict()
        """Number and time of the newest command by key; the one that was used last is the last."""

    def number(self, sender: Sender, now_s: float | None = None) -> int:
        """Return the number of a sender. More senders than PLACES count as those that cannot be
        distinguished."""
        now_s = time.monotonic() if now_s is None else now_s
        if sender.key is None:
            return SENDER_UNNAMED
        known = self._known.get(sender.key)
        number = self._free(now_s) if known is None else known[0]
        if number != SENDER_UNNAMED:
            self._known[sender.key] = number, now_s
            self._known.move_to_end(sender.key)
        return number

    def _free(self, now_s: float) -> int:
        """Return a number that no sender has, or no sender any more."""
        if len(self._known) < len(PLACES):
            return PLACES[len(self._known)]
        oldest = next(iter(self._known))
        if now_s - self._known[oldest][1] < KEPT_S:
            return SENDER_UNNAMED
        return self._known.pop(oldest)[0]
