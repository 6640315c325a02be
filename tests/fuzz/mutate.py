# SPDX-License-Identifier: Apache-2.0
"""Small changes of good inputs, drawn from a seeded random generator."""

from __future__ import annotations

import random
from collections.abc import Sequence

CHANGES_MAX = 4


def mutated(dice: random.Random, data: bytes, words: Sequence[bytes]) -> bytes:
    """Return `data` with one or a few changes; some insert one of `words`."""
    for _ in range(dice.randint(1, CHANGES_MAX)):
        data = _changed(dice, data, words)
    return data


def _changed(dice: random.Random, data: bytes, words: Sequence[bytes]) -> bytes:
    begin = dice.randint(0, len(data))
    end = min(len(data), begin + dice.choice((1, 2, 4, 16, 64)))
    match dice.randrange(7):
        case 0:  # flip a bit
            if begin == len(data):
                return data
            return data[:begin] + bytes((data[begin] ^ 1 << dice.randrange(8),)) + data[begin + 1 :]
        case 1:  # leave out
            return data[:begin] + data[end:]
        case 2:  # repeat
            return data[:end] + data[begin:]
        case 3:  # end here
            return data[:begin]
        case 4:  # random bytes
            return data[:begin] + dice.randbytes(end - begin) + data[end:]
        case 5:  # instead of some bytes
            return data[:begin] + dice.choice(words) + data[end:]
        case _:
            return data[:begin] + dice.choice(words) + data[begin:]
