# SPDX-License-Identifier: Apache-2.0
"""Bit errors on a wire. They are independent of each other and have a bit-error rate."""

from __future__ import annotations

import math
import random


def disturb(data: bytes, ber: float, bits: int, source: random.Random) -> tuple[bytes, int]:
    """Return the received bytes, and the number of bits that were hit. A character has `bits` on
    the wire: a hit start, parity or stop bit loses it (the receiver sees a framing or parity
    error), a hit data bit is flipped."""
    if ber <= 0.0:
        return data, 0
    received: list[int | None] = list(data)
    hits, at = 0, _next_hit(ber, source)
    while at < len(data) * bits:
        place, bit = divmod(at, bits)
        byte = received[place]
        is_data = 1 <= bit <= 8
        received[place] = byte ^ 1 << (bit - 1) if is_data and byte is not None else None
        hits += 1
        at += 1 + _next_hit(ber, source)
    return bytes(byte for byte in received if byte is not None), hits


def _next_hit(ber: float, source: random.Random) -> int:
    """Return the number of good bits before the next bad one: geometric (Devroye, Non-Uniform
    Random Variate Generation, 1986, X.2)."""
    return math.floor(math.log(1.0 - source.random()) / math.log1p(-ber))
