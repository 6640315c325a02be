# SPDX-License-Identifier: Apache-2.0
"""The kinds of faults and their keys: the syntax of a line of a fault script.

KIND[:KEY=VALUE,...]        described in docs/simulator.md
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from motord_hal.base.nearest import nearest
from motord_hal.drives.can_profile import NODE_MAX


class FaultError(ValueError):
    """The text is not a fault; the message has the reason and what is allowed."""


@dataclass(frozen=True, slots=True)
class Key:
    low: float
    high: float
    whole: bool = False
    default: float | None = None
    needed: bool = False


@dataclass(frozen=True, slots=True)
class Kind:
    happens: str
    """When the fault happens: "reply": to replies, by p or nth; "state": for a time; "once": at a
    time."""
    text: str
    keys: Mapping[str, Key]


_UNIT = Key(0, NODE_MAX, whole=True)
"""A Modbus address, or a node of a CAN bus."""
_CHANNEL = Key(1, 8, whole=True)
"""Number of the unit's motor. If it is not given: all motors."""
_TIME_S = Key(0.0, 1e6)
_SPAN = {"from_s": _TIME_S, "for_s": _TIME_S}
_WHEN = {"unit": _UNIT, **_SPAN}
_HOW_OFTEN = {**_WHEN, "p": Key(0.0, 1.0), "nth": Key(1, 1e9, whole=True)}
_AT = {"at_s": Key(0.0, 1e6, default=0.0)}
_FOR_S = Key(0.0, 1e6, needed=True)


def _ms(default: float) -> Key:
    return Key(0.0, 10_000.0, default=default)


def _reply(text: str, **keys: Key) -> Kind:
    return Kind("reply", text, {**_HOW_OFTEN, **keys})


def _state(text: str, **keys: Key) -> Kind:
    return Kind("state", text, {**_SPAN, **keys})


def _motor(text: str, **keys: Key) -> Kind:
    return _state(text, unit=_UNIT, channel=_CHANNEL, **keys)


def _once(text: str, **keys: Key) -> Kind:
    return Kind("once", text, {**_AT, **keys})


KINDS = MappingProxyType(
    {
        "drop": _reply("the request is obeyed, the reply is lost"),
        "delay": _reply("the reply comes later by this time", ms=_ms(50.0)),
        "late": _reply("the reply is held back until the next request has come"),
        "tear": _reply(
            "the reply ends after this many bytes", after_bytes=Key(0, 255, whole=True, default=4)
        ),
        "corrupt": _reply("one bit of the reply is flipped"),
        "glitch": _reply("a zero byte before the reply"),
        "wrong-unit": _reply("a good reply with another unit's address"),
        "exception": _reply(
            "this exception instead of the reply; the request is obeyed",
            code=Key(0, 255, whole=True, default=4),
        ),
        "stuck-de": _reply(
            "the adapter goes on driving after a request: what is replied meanwhile is lost",
            ms=_ms(2.0),
        ),
        "slow-flash": _reply(
            "after the write of a setting the unit receives nothing; with busy=1 it answers with"
            " exception 6",
            ms=_ms(100.0),
            busy=Key(0, 1, whole=True, default=0),
        ),
        "unheard": _reply("CAN: a frame to the drive is lost"),
        "segments": _reply("TCP: the reply comes in pieces, this far apart", ms=_ms(5.0)),
        "silence": _state("the unit receives nothing", unit=_UNIT, for_s=_FOR_S),
        "turnaround": _state(
            "the unit takes this time to answer, and up to the spread longer, evenly",
            unit=_UNIT,
            ms=_ms(1.0),
            spread_ms=_ms(0.0),
        ),
        "echo": _state("the adapter receives what it sends: requests come back"),
        "noise": _state(
            "bit errors in both directions at this rate; a hit start or stop bit loses the byte",
            ber=Key(0.0, 0.1, default=1e-4),
        ),
        "babble": _state("bytes out of nothing, at this rate", hz=Key(0.001, 1000.0, default=2.0)),
        "wrong-baud": _state(
            "the unit is set to another baud rate",
            unit=_UNIT,
            baudrate=Key(300, 4_000_000, whole=True, needed=True),
        ),
        "wrong-parity": _state(
            "the unit is set to another parity: noise in both directions", unit=_UNIT
        ),
        "slip": _state(
            "this share of the travel of one side's wheels (0 left, 1 right) is slip",
            side=Key(0, 1, whole=True, needed=True),
            part=Key(0.0, 1.0, default=0.5),
        ),
        "frozen-counter": _motor("the position counters stand still"),
        "turned-encoder": _motor("the encoders count backward, velocities too"),
        "unplugged-encoder": _motor("the encoders show a wheel that stands still"),
        "false-velocity": _motor(
            "the reported velocity of the motor is this, forward and backward in turn",
            rad_s=Key(0.0, 1e6, default=343.0),
        ),
        "blocked": _motor("the wheels cannot turn"),
        "runaway": _motor(
            "while it has power the motor turns at this speed, whatever the set-point is",
            rad_s=Key(-1e6, 1e6, default=15.0),
        ),
        "tcp-stall": _once(
            "TCP: nothing passes in or out, then all of it", for_s=Key(0.0, 1e6, default=1.0)
        ),
        "half-open": _once("TCP: connections are dropped silently; new ones are served"),
        "bus-off": _once(
            "CAN: the master's controller goes bus-off; nothing passes",
            for_s=Key(0.0, 1e6, default=0.5),
        ),
        "reboot": _once(
            "no power; then defaults, counter at its start, disabled",
            unit=_UNIT,
            for_s=Key(0.0, 1e6, default=0.5),
        ),
        "brown-out": _once(
            "a short dip: defaults, disabled; with keep=1 the counter survives",
            unit=_UNIT,
            for_s=Key(0.0, 1e6, default=0.02),
            keep=Key(0, 1, whole=True, default=0),
        ),
        "fault": _once(
            "the drive latches this fault of its profile",
            unit=_UNIT,
            channel=Key(1, 8, whole=True, default=1),
            bit=Key(0, 31, whole=True),
            code=Key(1, 0xFFFF, whole=True),
        ),
        "encoder-wrap": _once("the counters stand a quarter turn before their wrap", unit=_UNIT),
        "unplug": _once(
            "all adapters are pulled, and plugged again", for_s=Key(0.0, 1e6, default=1.0)
        ),
    }
)


def list_kinds() -> dict[str, Any]:
    """Return all kinds as plain values, for programs that make up scripts."""
    return {
        name: {
            "happens": kind.happens,
            "text": kind.text,
            "keys": {
                key: {
                    "low": limits.low,
                    "high": limits.high,
                    "whole": limits.whole,
                    "default": limits.default,
                    "needed": limits.needed,
                }
                for key, limits in kind.keys.items()
            },
        }
        for name, kind in KINDS.items()
    }


def parse_fault(text: str) -> tuple[str, dict[str, float]]:
    """Return kind and values of one entry, with defaults filled in. Raises FaultError."""
    kind, _, rest = text.strip().partition(":")
    if kind not in KINDS:
        raise FaultError(f'"{text}": no fault "{kind}"{_hint(kind, KINDS)}')
    keys = KINDS[kind].keys
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


def _number(text: str, name: str, value: str, key: Key) -> float:
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
    near = nearest(word, known)
    return f"; did you mean {near}?" if near else f"; known: {', '.join(known)}"
