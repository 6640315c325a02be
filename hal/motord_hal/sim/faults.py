# SPDX-License-Identifier: Apache-2.0
"""A script of faults of the wire and the drives, with their times. The same seed and the same
requests give the same faults. `fault_kinds` has the kinds.

A fault of replies happens to every reply, or with `p=` to this part of them, or with `nth=` to each
nth one. `unit=` limits it to one drive, `from_s=` and `for_s=` to a time.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from motord_hal.modbus.codec import UNIT_MAX
from motord_hal.sim.axis import Defect
from motord_hal.sim.fault_kinds import KINDS, parse_fault
from motord_hal.sim.rs485.framing import Rewriting

MOTOR_DEFECTS = (
    "frozen-counter", "turned-encoder", "unplugged-encoder", "false-velocity", "blocked", "runaway",
)  # fmt: skip


@dataclass(slots=True)
class Fault:
    """One entry of the script. Times are on the rig's clock."""

    text: str
    kind: str
    values: dict[str, float]
    starts_s: float
    random: random.Random
    seen: int = 0
    """Number of replies to which the fault could have happened."""
    fired: int = 0
    waits_until_s: float = 0.0
    """For the kind "babble": time of the next bytes."""

    @property
    def once(self) -> bool:
        return KINDS[self.kind].happens == "once"

    @property
    def of_drive(self) -> tuple[int, int | None, int | None]:
        """Channel, bit and code of a drive's fault; None: not given."""
        values = self.values
        return int(values["channel"]), _whole(values.get("bit")), _whole(values.get("code"))

    def over(self, now_s: float) -> bool:
        """Whether the fault has no further effect."""
        if self.once:
            return self.fired > 0
        return now_s >= self.starts_s + self.values.get("for_s", math.inf)

    def matches(self, unit: int | None, now_s: float) -> bool:
        """Whether the fault applies now to this unit; None: to the line itself."""
        ends_s = self.starts_s + self.values.get("for_s", math.inf)
        return self.values.get("unit", unit) == unit and self.starts_s <= now_s < ends_s

    def strikes(self, unit: int, now_s: float) -> bool:
        """Whether the fault happens to this reply. The call counts the reply."""
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
    """A reply, and its changes by faults."""

    frame: bytes
    delay_s: float = 0.0
    held: bool = False
    """Whether the reply is kept back until the next request has come. It is then a late reply, and
    not the answer to that request."""
    deafening_s: float = 0.0
    """Time after the request's end for which the adapter still drives the wire."""
    segments_s: float = 0.0
    """For TCP: time between the pieces of the reply."""


@dataclass(slots=True)
class FaultScript:
    seed: int
    faults: list[Fault] = field(default_factory=list)
    past: Counter[str] = field(default_factory=Counter)
    """Counts of ended entries, by kind."""
    _added: int = 0

    def add(self, text: str, now_s: float = 0.0) -> Fault:
        """Add an entry. Its times count from `now_s`. Ended entries are removed, so that a long run
        stays fast. Raises FaultError."""
        kind, values = parse_fault(text)
        self._forget(fault for fault in self.faults if fault.over(now_s))
        starts_s = now_s + values.get("at_s", values.get("from_s", 0.0))
        seeded = random.Random(f"{self.seed} {self._added} {kind}")
        self._added += 1
        fault = Fault(text, kind, values, starts_s, seeded, waits_until_s=starts_s)
        self.faults.append(fault)
        return fault

    def clear(self) -> None:
        self._forget(self.faults)

    def _forget(self, gone: Iterable[Fault]) -> None:
        for fault in list(gone):
            self.past[fault.kind] += fault.fired
            self.faults.remove(fault)

    def due(self, now_s: float) -> Iterable[Fault]:
        """Yield the entries that happen once and are due."""
        for fault in self.faults:
            if fault.once and not fault.fired and now_s >= fault.starts_s:
                fault.fired = 1
                yield fault

    def states(self, kind: str, unit: int | None, now_s: float) -> Iterator[Fault]:
        """Yield the active entries of a kind, for a unit or (None) for the line, and count them."""
        for fault in self.faults:
            if fault.kind == kind and fault.matches(unit, now_s):
                fault.fired += 1
                yield fault

    def defects(self, unit: int, now_s: float) -> tuple[Defect, ...]:
        """Return the present defects of this unit's motors."""
        if not self.faults:
            return ()
        return tuple(
            Defect(fault.kind, _whole(fault.values.get("channel")), fault.values.get("rad_s", 0.0))
            for kind in MOTOR_DEFECTS
            for fault in self.states(kind, unit, now_s)
        )

    def silent(self, unit: int, now_s: float) -> bool:
        """Whether this unit receives nothing now."""
        return any(True for _ in self.states("silence", unit, now_s))

    def turnaround_s(self, unit: int, now_s: float) -> float | None:
        """Return the time that this unit takes to answer; None: the profile's time."""
        for fault in self.states("turnaround", unit, now_s):
            spread_ms = fault.random.uniform(0.0, fault.values["spread_ms"])
            return (fault.values["ms"] + spread_ms) / 1000.0
        return None

    def flash(self, unit: int, now_s: float) -> Fault | None:
        """Return the slow-flash fault that happens to this write of a setting, or None."""
        for fault in self.faults:
            if fault.kind == "slow-flash" and fault.strikes(unit, now_s):
                return fault
        return None

    def spoil(self, unit: int, frame: bytes, framing: Rewriting, now_s: float) -> Spoiled:
        """Return a good reply as it goes on the wire. A dropped one is empty."""
        spoiled = Spoiled(frame)
        for fault in self.faults:
            on_replies = KINDS[fault.kind].happens == "reply" and fault.kind != "slow-flash"
            if on_replies and spoiled.frame and fault.strikes(unit, now_s):
                _spoil(spoiled, unit, framing, fault)
        return spoiled


def _whole(value: float | None) -> int | None:
    return None if value is None else int(value)


def _spoil(spoiled: Spoiled, unit: int, framing: Rewriting, fault: Fault) -> None:
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
            other = fault.random.choice([one for one in range(1, UNIT_MAX) if one != unit])
            spoiled.frame = framing.readdressed(frame, other)
        case "exception" if len(frame) > 1:  # a shorter one does not show what it answers
            spoiled.frame = framing.refusal(frame, int(fault.values["code"]))
        case "stuck-de":
            spoiled.deafening_s = max(spoiled.deafening_s, fault.values["ms"] / 1000.0)
        case "segments":
            spoiled.segments_s = max(spoiled.segments_s, fault.values["ms"] / 1000.0)
