# SPDX-License-Identifier: Apache-2.0
"""Random messages of a type, and the comparison of two messages."""

import math
import struct
from types import SimpleNamespace

from motord.bus.messages.table import TYPES

# A byte has 7 bits here: rosbags writes it as a signed number.
_BITS = {"char": 8, "byte": 7, "uint8": 8, "uint16": 16, "uint32": 32, "uint64": 64}
_SIGNED_BITS = {"int8": 8, "int16": 16, "int32": 32, "int64": 64}
_TEXTS = ("", "a", "odom", "base_link", "Räder: 2 × 0,1 m", "x" * 57)


def any_message(rng, name):
    """Return a random message with sequences of any length; numbers may be NaN and infinity."""
    return SimpleNamespace(**{field.name: _any_field(rng, field) for field in TYPES[name]})


def _any_field(rng, field):
    if field.count is None:
        return _any_value(rng, field.kind)
    count = field.count
    if field.sequence:
        count = rng.randint(0, field.count) if field.bounded else rng.choice((0, 1, 2, 3, 7))
    return tuple(_any_value(rng, field.kind) for _ in range(count))


def _any_value(rng, kind):
    if kind == "string":
        return rng.choice(_TEXTS)
    if kind == "bool":
        return rng.random() < 0.5
    if kind in _BITS:
        return rng.getrandbits(_BITS[kind])
    if kind in _SIGNED_BITS:
        half = 1 << (_SIGNED_BITS[kind] - 1)
        return rng.randrange(-half, half)
    if kind in ("float32", "float64"):
        value = rng.choice((0.0, -0.0, math.inf, math.nan, rng.gauss(0.0, 1e3), rng.random()))
        return struct.unpack("<f", struct.pack("<f", value))[0] if kind == "float32" else value
    return any_message(rng, kind)


def same(one, other):
    """Return whether both are equal; NaN equals NaN."""
    if isinstance(one, SimpleNamespace):
        return vars(one).keys() == vars(other).keys() and all(
            same(value, getattr(other, key)) for key, value in vars(one).items()
        )
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and math.isnan(one):
        return math.isnan(other)
    return one == other
