# SPDX-License-Identifier: Apache-2.0
"""Checks that the drive had really reported each count that the core was given, at that time."""

from __future__ import annotations

import bisect
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from motord_hal.drives.profile import Register
from motord_hal.sim.control import SimControl

EXCHANGE_S = 0.05
"""Longest duration of an exchange: 1 ms turn-around, 20 ms allowance, 2 ms on the wire, and as much
again for a late machine."""
PAGE = 1000
"""Largest number of journal entries in one answer."""


@dataclass(slots=True)
class Unit:
    """The reported counts of one drive with their times, and the next journal number to request."""

    asked: int = 0
    times_ns: defaultdict[int, list[int]] = field(default_factory=lambda: defaultdict(list))


@dataclass(slots=True)
class Reported:
    """Checker of the counts. `units`: unit of each joint's drive, in the core's order."""

    line: str
    units: tuple[int, ...]
    position: Register
    tap: Path
    violations: list[str] = field(default_factory=list)
    checked: int = 0
    old: int = 0
    """Number of answers to an earlier, equal request of a drive: RTU cannot distinguish them."""
    oldest_s: float = 0.0
    _read: int = 0
    _known: dict[int, Unit] = field(default_factory=dict)

    def check(self, sim: SimControl) -> None:
        """Judge the new counts. The tap is read first: the journal is ahead of it, because a drive
        reports a count before the core accepts it."""
        accepted = self._accepted()
        for unit in self.units:
            self._learn(sim, unit)
        for joint, stamp_ns, count in accepted:
            self._judge(joint, stamp_ns, count)

    def _accepted(self) -> list[tuple[int, int, int]]:
        with self.tap.open(encoding="ascii") as file:
            file.seek(self._read)
            text = file.read()
        whole = text[: text.rfind("\n") + 1]
        self._read += len(whole)
        rows = (line.split() for line in whole.splitlines())
        return [(int(joint), int(stamp), int(count)) for joint, stamp, count, _ in rows]

    def _learn(self, sim: SimControl, unit: int) -> None:
        known = self._known.setdefault(unit, Unit())
        while entries := sim.journal(self.line, unit, known.asked):
            for entry in entries:
                offset = self.position.address - entry["address"]
                words = entry["words"][offset : offset + self.position.type.words]
                if offset >= 0 and len(words) == self.position.type.words:
                    count = self.position.decode(tuple(words)) % (1 << 32)
                    known.times_ns[count].append(entry["monotonic_ns"])
            known.asked = entries[-1]["number"] + 1
            if len(entries) < PAGE:
                return

    def _judge(self, joint: int, stamp_ns: int, count: int) -> None:
        unit = self.units[joint]
        times = self._known[unit].times_ns.get(count, [])
        self.checked += 1
        window_ns = round(EXCHANGE_S * 1e9)
        newest = bisect.bisect_right(times, stamp_ns + window_ns)
        if newest == 0:
            self.violations.append(
                f"joint {joint} was given the count {count:#x} at {stamp_ns} ns:"
                f" drive {unit} has not reported it{' before' if times else ''}"
            )
        elif (age_ns := stamp_ns - times[newest - 1]) > window_ns:
            self.old += 1
            self.oldest_s = max(self.oldest_s, age_ns * 1e-9)
