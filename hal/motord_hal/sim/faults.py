# SPDX-License-Identifier: Apache-2.0
"""A script of faults: what the wire and the drives do wrong, and when. The same seed and the same
requests give the same faults.

    KIND[:KEY=VALUE,...]        which ones there are: docs/simulator.md

A fault of replies happens to every one, or with `p=` to this part of them, or with `nth=` to each
nth one; `unit=` keeps it to one drive, `from_s=` and `for_s=` to a time.
"""

from __future__ import annotations

import difflib
import math
import random
from collections.abc import Iterable
from dataclasses import dataclass, field
from types import MappingProxyType

from motord_hal.modbus.codec import UNIT_MAX, build_exception, seal


class FaultError(ValueError):
    """The text is no fault; the message says why and what would be."""


@dataclass(frozen=True, slots=True)
class _Key:
    low: float
    high: float
    whole: bool = False
    default: float | None = None
    needed: bool = False


_UNIT = _Key(1, UNIT_MAX, whole=True)
_TIME_S = _Key(0.0, 1e6)
_WHEN = {"unit": _UNIT, "from_s": _TIME_S, "for_s": _TIME_S}
_REPLY = {**_WHEN, "p": _Key(0.0, 1.0), "nth": _Key(1, 1e9, whole=True)}
_AT = {"at_s": _Key(0.0, 1e6, default=0.0)}

KINDS = MappingProxyType(
    {
        "drop": _REPLY,
        "delay": {**_REPLY, "ms": _Key(0.0, 10_000.0, default=50.0)},
        "late": _REPLY,
        "tear": {**_REPLY, "after_bytes": _Key(0, 255, whole=True, default=4)},
        "corrupt": _REPLY,
        "glitch": _REPLY,
        "wrong-unit": _REPLY,
        "exception": {**_REPLY, "code": _Key(1, 255, whole=True, default=4)},
        "silence": {**_WHEN, "for_s": _Key(0.0, 1e6, needed=True)},
        "reboot": {**_AT, "unit": _UNIT, "for_s": _Key(0.0, 1e6, default=0.5)},
        "fault": {
            **_AT,
            "unit": _UNIT,
            "channel": _Key(1, 8, whole=True, default=1),
            "bit": _Key(0, 31, whole=True),
            "code": _Key(1, 0xFFFF, whole=True),
        },
        "encoder-wrap": {**_AT, "unit": _UNIT},
        "unplug": {**_AT, "for_s": _Key(0.0, 1e6, default=1.0)},
    }
)
ONCE = ("reboot", "fault", "encoder-wrap", "unplug")
"""Those that happen at a time, not to a reply."""


@dataclass(slots=True)
class Fault:
    """One entry of the script. Times are on the rig's clock."""

    text: str
    kind: str
    values: dict[str, float]
    starts_s: float
    random: random.Random
    seen: int = 0
    """Replies that it could have happened to."""
    fired: int = 0

    def matches(self, unit: int, now_s: float) -> bool:
        ends_s = self.starts_s + self.values.get("for_s", math.inf)
        return self.values.get("unit", unit) == unit and self.starts_s <= now_s < ends_s

    def strikes(self, unit: int, now_s: float) -> bool:
        """Whether it happens to this reply."""
        if not self.matches(unit, now_s):
            return False
        self.seen += 1
        if "nth" in self.values:
            hit = self.seen % int(self.values["nth"]) == 0
        else:
            hit = self.random.random() < self.values.get("p", 1.0)
        self.fired += hit
        return hit


@dataclass(slots=True)
class Spoiled:
    """What becomes of a reply."""

    frame: bytes
    delay_s: float = 0.0
    held: bool = False
    """Kept back until the next request has come: the late reply that must not be taken for its
    answer."""


@dataclass(slots=True)
class FaultScript:
    seed: int
    faults: list[Fault] = field(default_factory=list)
    _added: int = 0

    def add(self, text: str, now_s: float = 0.0) -> Fault:
        """Add an entry; its times count from now_s. Raises FaultError."""
        kind, values = parse_fault(text)
        starts_s = now_s + values.get("at_s", values.get("from_s", 0.0))
        seeded = random.Random(f"{self.seed} {self._added} {kind}")
        self._added += 1
        fault = Fault(text, kind, values, starts_s, seeded)
        self.faults.append(fault)
        return fault

    def clear(self) -> None:
        self.faults.clear()

    def due(self, now_s: float) -> Iterable[Fault]:
        """Those that happen once and whose time has come."""
        for fault in self.faults:
            if fault.kind in ONCE and not fault.fired and now_s >= fault.starts_s:
                fault.fired = 1
                yield fault

    def silent(self, unit: int, now_s: float) -> bool:
        """Whether this unit hears nothing now."""
        for fault in self.faults:
            if fault.kind == "silence" and fault.matches(unit, now_s):
                fault.fired += 1
                return True
        return False

    def spoil(self, frame: bytes, now_s: float) -> Spoiled:
        """A good reply as it goes on the wire; nothing is left of a dropped one."""
        spoiled = Spoiled(frame)
        unit = frame[0]
        for fault in self.faults:
            on_replies = fault.kind not in ONCE and fault.kind != "silence"
            if on_replies and spoiled.frame and fault.strikes(unit, now_s):
                _spoil(spoiled, fault)
        return spoiled


def _spoil(spoiled: Spoiled, fault: Fault) -> None:
    frame = spoiled.frame
    match fault.kind:
        case "drop":
            spoiled.frame = b""
        case "delay":
            spoiled.delay_s += fault.values["ms"] / 1000.0
        case "late":
            spoiled.held = True
        case "tear":
            spoiled.frame = frame[: int(fault.values["after_bytes"])]
        case "corrupt":
            bit = fault.random.randrange(8 * len(frame))
            value = int.from_bytes(frame, "little") ^ 1 << bit
            spoiled.frame = value.to_bytes(len(frame), "little")
        case "glitch":
            spoiled.frame = b"\x00" + frame
        case "wrong-unit":
            other = fault.random.choice([unit for unit in range(1, UNIT_MAX) if unit != frame[0]])
            spoiled.frame = seal(bytes([other]) + frame[1:-2])
        case "exception":
            spoiled.frame = build_exception(frame[0], frame[1], int(fault.values["code"]))


def parse_fault(text: str) -> tuple[str, dict[str, float]]:
    """Kind and values of one entry, defaults filled in. Raises FaultError."""
    kind, _, rest = text.strip().partition(":")
    if kind not in KINDS:
        raise FaultError(f'"{text}": no fault "{kind}"{_hint(kind, KINDS)}')
    keys = KINDS[kind]
    values = {name: key.default for name, key in keys.items() if key.default is not None}
    for pair in filter(None, rest.split(",")):
        name, equals, value = (part.strip() for part in pair.partition("="))
        if name not in keys:
            raise FaultError(f'"{text}": {kind} has no key "{name}"{_hint(name, keys)}')
        if not equals:
            raise FaultError(f'"{text}": {name} needs a value: {name}=...')
        values[name] = _number(text, name, value, keys[name])
    missing = [name for name, key in keys.items() if key.needed and name not in values]
    if missing:
        raise FaultError(f'"{text}": {kind} needs {missing[0]}=...')
    if "p" in values and "nth" in values:
        raise FaultError(f'"{text}": either p or nth')
    if kind == "fault" and ("bit" in values) == ("code" in values):
        raise FaultError(f'"{text}": fault needs either bit= or code=')
    return kind, values


def _number(text: str, name: str, value: str, key: _Key) -> float:
    try:
        number = float(value)
    except ValueError:
        raise FaultError(f'"{text}": {name}: expected a number, got "{value}"') from None
    if not key.low <= number <= key.high:
        raise FaultError(f'"{text}": {name}: {value} is not in {key.low:g} to {key.high:g}')
    if key.whole and number != int(number):
        raise FaultError(f'"{text}": {name}: {value} is not a whole number')
    return number


def _hint(word: str, known: Iterable[str]) -> str:
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known)}"
