# SPDX-License-Identifier: Apache-2.0
"""The guarded port with its line counters. It counts every exchange, and every failure by kind."""

from __future__ import annotations

import math
from collections import Counter

from motord_hal.asyncio_engine.tally import RoundTripTally
from motord_hal.base.errors import BadReply, NoReply, PortError, Refused
from motord_hal.modbus.codec import Request
from motord_hal.modbus.guard import Answer, GuardedClient

_KINDS = ((NoReply, "no_reply"), (BadReply, "bad_reply"), (Refused, "refused"), (PortError, "port"))


class Link:
    """The port through which drives send and receive."""

    def __init__(self, client: GuardedClient) -> None:
        self.client = client
        self.exchanges = 0
        self.errors: Counter[str] = Counter()
        self.round_trips = RoundTripTally()

    async def ask(
        self,
        request: Request,
        within_s: float,
        send_by_s: float = math.inf,
        *,
        urgent: bool = False,
    ) -> Answer:
        """Exchange as `GuardedClient.exchange` does, and count."""
        try:
            answer = await self.client.exchange(request, within_s, send_by_s, urgent=urgent)
        except (NoReply, BadReply, Refused, PortError) as error:
            kind = next(word for cls, word in _KINDS if isinstance(error, cls))
            self.errors[kind] += 1
            raise
        finally:
            self.exchanges += 1
        self.round_trips.add(answer.round_trip_s)
        return answer
