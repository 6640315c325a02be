# SPDX-License-Identifier: Apache-2.0
"""A seeded script of faults: every kind that a serial line has, evenly mixed, in batches."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator, Sequence

from motord_hal.sim.fault_kinds import KINDS
from motord_hal.sim.faults import MOTOR_DEFECTS

UNITS = 4
BATCH_S = 1.6
"""The faults of a batch begin within this time."""
RARE_PART = 0.8
"""Part of the reply faults that hit single replies during the whole batch: the robot drives on, and
the counts that it accepts are checked. The other faults hit every reply for a moment."""
RARE_P = 0.02
FAULT_BITS = (0, 2, 5, 10)
"""Fault bits of the profile, one of them a warning."""
VARIANTS = {
    "late-for-long": ("delay", {"ms": (5.0, 100.0), "for_s": (0.2, BATCH_S), "p": (1.0, 1.0)}),
    "exception-code-0": ("exception", {"code": (0.0, 0.0), "p": (RARE_P, 1.0)}),
}
"""Kinds of this mix: a kind of the simulator, and the ranges of its values. A drive answers so late
that replies meet newer requests; an exception has a code that the standard does not have."""
UNTAGS = "encoder-wrap"
"""Kind that removes the tags of the counters: it comes in the second half of a robot's life."""
_NOT_OF_LINES = ("unheard", "bus-off", *MOTOR_DEFECTS)
SERIAL_KINDS = (*(kind for kind in KINDS if kind not in _NOT_OF_LINES), *VARIANTS)
"""All kinds of a serial line: two belong to CAN alone. Defects of motor and encoder change what is
judged here, the wheel's speed and its counts: tests/sim/robots/test_doubted_feedback.py has them.
"""
_OWN_KEYS = ("unit", "from_s", "at_s", "for_s", "p", "nth")


# ranges of values that are drawn evenly, instead of the kind's whole range
_RANGES = {
    ("delay", "ms"): (1, 100),
    ("segments", "ms"): (1, 10),
    ("tear", "after_bytes"): (0, 12),
    ("exception", "code"): (1, 11),
    ("stuck-de", "ms"): (0.5, 6),
    ("slow-flash", "ms"): (20, 200),
    ("turnaround", "ms"): (0, 6),
    ("turnaround", "spread_ms"): (0, 4),
    ("babble", "hz"): (1, 60),
    ("fault", "channel"): (1, 1),
}
_LENGTH_S = {"reboot": (0.05, 0.4), "brown-out": (0.01, 0.1), "unplug": (0.05, 0.6),
             "tcp-stall": (0.05, 0.5)}  # fmt: skip
_BITRATES = (9600, 38400, 57600, 230400)


def batches(
    seed: int, faults: int, size: int, of: Sequence[str] = SERIAL_KINDS
) -> Iterator[list[tuple[str, str]]]:
    """Yield the batches of one robot's life: kind and text of each fault, determined by `seed`."""
    dice = random.Random(seed)
    kinds = list(itertools.islice(itertools.cycle(_shuffled(dice, list(of))), faults))
    dice.shuffle(kinds)
    later = [kind for kind in kinds if kind == UNTAGS]
    kinds = [kind for kind in kinds if kind != UNTAGS]
    half = len(kinds) // 2
    late = kinds[half:] + later
    dice.shuffle(late)
    for batch in _cut(kinds[:half] + late, size):
        yield [(kind, fault(dice, kind)) for kind in batch]


def _cut(items: list[str], size: int) -> Iterator[list[str]]:
    for begin in range(0, len(items), size):
        yield items[begin : begin + size]


def _shuffled(dice: random.Random, items: list[str]) -> list[str]:
    dice.shuffle(items)
    return items


def fault(dice: random.Random, kind: str) -> str:
    """Return a fault of that kind: short, somewhere in the batch, at one drive or at all."""
    kind, ranges = VARIANTS.get(kind, (kind, {}))
    keys = KINDS[kind].keys
    values: dict[str, float] = {}
    begins = "at_s" if "at_s" in keys else "from_s"
    values[begins] = dice.uniform(0.0, BATCH_S)
    if "unit" in keys and dice.random() < 0.8:
        values["unit"] = dice.randint(1, UNITS)
    if "for_s" in keys:
        low, high = _LENGTH_S.get(kind, (0.02, 0.2))
        values["for_s"] = dice.uniform(low, high)
    if "p" in keys and dice.random() < RARE_PART:
        values["for_s"], values["p"] = BATCH_S, RARE_P
    for name in keys:
        if name not in _OWN_KEYS:
            values |= _own(dice, kind, name)
    values |= {name: dice.uniform(low, high) for name, (low, high) in ranges.items()}
    return f"{kind}:" + ",".join(f"{name}={value:.6g}" for name, value in values.items())


def _own(dice: random.Random, kind: str, name: str) -> dict[str, float]:
    key = KINDS[kind].keys[name]
    match kind, name:
        case "fault", "bit":
            return {"bit": dice.choice(FAULT_BITS)}
        case "fault", "code":
            return {}
        case "wrong-baud", "baudrate":
            return {"baudrate": dice.choice(_BITRATES)}
        case "noise", "ber":
            return {"ber": 10 ** dice.uniform(-4.0, -1.7)}
    low, high = _RANGES.get((kind, name), (key.low, key.high))
    return {name: dice.randint(int(low), int(high)) if key.whole else dice.uniform(low, high)}
