# SPDX-License-Identifier: Apache-2.0
"""The wire of a line: bytes go out one by one at the baud rate, and lateness is measured.

A pty carries a frame in no time. Here each byte comes at its time on a real wire, in pieces of
about a millisecond, as from a UART's receive buffer.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from motord_hal.sim.rs485.port import Port

Clock = Callable[[], float]
PIECE_S = 0.001
ROUNDING_CHARACTERS = 0.0005
"""Tolerance so that a rounding error delays nothing that is due now."""
LATENESS_KEPT = 20_000
"""Number of newest frames that the percentiles include."""


@dataclass(slots=True)
class _Outgoing:
    starts_s: float
    frame: bytes
    sent: int = 0


@dataclass(slots=True)
class Lateness:
    """Delay of the last byte of a frame behind its time."""

    _late_us: deque[float] = field(default_factory=lambda: deque(maxlen=LATENESS_KEPT))

    def add(self, late_s: float) -> None:
        self._late_us.append(late_s * 1e6)

    def percentiles(self) -> dict[str, float]:
        """Return p50, p99 and the worst, in microseconds; empty before the first frame."""
        if not self._late_us:
            return {}
        ranked = sorted(self._late_us)
        last = len(ranked) - 1
        return {
            "p50": ranked[last // 2],
            "p99": ranked[math.ceil(0.99 * last)],
            "max": ranked[last],
        }


class Wire:
    """The half-duplex pair, from the drives' side. `free_s` is the time when its last byte was
    over."""

    def __init__(self, port: Port, character_s: float) -> None:
        self.character_s = character_s
        self.lateness = Lateness()
        self.bytes_sent = 0
        self._port = port
        self.unresponsive()

    def unresponsive(self) -> None:
        """Drop bytes in transit."""
        self.free_s = -math.inf
        self._outgoing: deque[_Outgoing] = deque()

    def receive(self, count: int, now_s: float) -> None:
        """Add `count` bytes that the master has put on the wire."""
        self.free_s = max(self.free_s, now_s) + count * self.character_s

    def send(self, frame: bytes, starts_s: float) -> None:
        """Queue bytes behind those in transit."""
        if self._outgoing:
            last = self._outgoing[-1]
            starts_s = max(starts_s, last.starts_s + len(last.frame) * self.character_s)
        self._outgoing.append(_Outgoing(starts_s, frame))

    def due_s(self) -> float:
        if not self._outgoing:
            return math.inf
        first = self._outgoing[0]
        piece = max(1, round(PIECE_S / self.character_s))
        upto = min(first.sent + piece, len(first.frame))
        return first.starts_s + upto * self.character_s

    def work(self, clock: Clock) -> None:
        """Send the bytes that are due."""
        while self._outgoing and self._port.plugged:
            first = self._outgoing[0]
            now_s = clock()
            passed = (now_s - first.starts_s) / self.character_s + ROUNDING_CHARACTERS
            upto = max(first.sent, min(len(first.frame), math.floor(passed)))
            if upto > first.sent:
                self.bytes_sent += self._port.put(first.frame[first.sent : upto], now_s)
                first.sent = upto
            if upto < len(first.frame):
                return
            self.lateness.add(clock() - first.starts_s - upto * self.character_s)
            # Read the clock before the write: a preemption after it must not count as lateness.
            self.free_s = max(self.free_s, now_s)
            self._outgoing.popleft()
