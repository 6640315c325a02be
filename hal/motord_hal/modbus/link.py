# SPDX-License-Identifier: Apache-2.0
"""The guarded port with its books: every exchange is counted, every failure by its kind."""

from __future__ import annotations

import math
from collections import deque

from motord_hal.clock import now_s
from motord_hal.errors import BadReply, NoReply, PortError, Refused
from motord_hal.modbus.codec import Request
from motord_hal.modbus.guard import Answer, GuardedClient
from motord_hal.ports import LineStats, RoundTrips

ROUND_TRIPS_KEPT = 2000
CYCLES_KEPT = 64
_KINDS = ((NoReply, "no_reply"), (BadReply, "bad_reply"), (Refused, "refused"), (PortError, "port"))


class Link:
    """What drives talk through."""

    def __init__(self, client: GuardedClient) -> None:
        self.client = client
        self.reopened = 0
        self._exchanges = 0
        self._cycles = 0
        self._errors: dict[str, int] = {}
        self._round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS_KEPT)
        self._cycle_starts_s: deque[float] = deque(maxlen=CYCLES_KEPT)

    async def ask(self, request: Request, within_s: float, send_by_s: float = math.inf) -> Answer:
        """As GuardedClient.exchange."""
        try:
            answer = await self.client.exchange(request, within_s, send_by_s)
        except (NoReply, BadReply, Refused, PortError) as error:
            kind = next(word for cls, word in _KINDS if isinstance(error, cls))
            self._errors[kind] = self._errors.get(kind, 0) + 1
            raise
        finally:
            self._exchanges += 1
        self._round_trips_s.append(answer.round_trip_s)
        return answer

    def count_cycle(self) -> None:
        """A cycle begins now."""
        self._cycles += 1
        self._cycle_starts_s.append(now_s())

    def stats(self, wire_limit_hz: float) -> LineStats:
        """Counters since start; rates and percentiles over the newest exchanges."""
        starts = self._cycle_starts_s
        span_s = starts[-1] - starts[0] if len(starts) > 1 else 0.0
        return LineStats(
            exchanges=self._exchanges,
            cycles=self._cycles,
            reopened=self.reopened,
            errors=dict(self._errors),
            cycle_hz=(len(starts) - 1) / span_s if span_s > 0 else 0.0,
            wire_limit_hz=wire_limit_hz,
            round_trip=_percentiles(sorted(self._round_trips_s)),
        )


def _percentiles(ordered_s: list[float]) -> RoundTrips:
    if not ordered_s:
        return RoundTrips()
    last = len(ordered_s) - 1
    p50_s, p99_s, max_s = (ordered_s[round(last * fraction)] for fraction in (0.5, 0.99, 1.0))
    return RoundTrips(p50_us=p50_s * 1e6, p99_us=p99_s * 1e6, max_us=max_s * 1e6)
