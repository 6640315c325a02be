# SPDX-License-Identifier: Apache-2.0
"""Judgement of heartbeats: whether everything that must move still moves. Pure: time is an
argument.

A heart is a counter. It beats when the counter has moved within the heart's own time. A heart may
be excused (a line that is being reopened has no cycles, and reports that itself); an excused heart
neither beats nor fails. The supervisor's watchdog is fed only if no heart fails."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Heart:
    """One counter at one moment. `within_s`: how long it may stand still."""

    name: str
    count: int
    within_s: float
    excused: bool = False


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a look. `stalled`: hearts that fail now. `messages`: changes for the log, once
    each."""

    stalled: tuple[str, ...]
    messages: tuple[str, ...]

    @property
    def well(self) -> bool:
        return not self.stalled


@dataclass(slots=True)
class _Record:
    count: int
    moved_ns: int
    stalled: bool = False
    stalls: int = 0


class Health:
    """Record of when each counter moved last."""

    def __init__(self) -> None:
        self._records: dict[str, _Record] = {}

    def judge(self, now_ns: int, hearts: Iterable[Heart]) -> Verdict:
        """Judge all hearts. A heart that is seen for the first time counts as having just
        beaten."""
        stalled: list[str] = []
        messages: list[str] = []
        for heart in hearts:
            record = self._records.setdefault(heart.name, _Record(heart.count, now_ns))
            message = _update(record, heart, now_ns)
            if message is not None:
                messages.append(message)
            if record.stalled:
                stalled.append(heart.name)
        return Verdict(tuple(stalled), tuple(messages))

    def stalls(self) -> dict[str, int]:
        """Return how often each heart has stopped so far."""
        return {name: record.stalls for name, record in self._records.items()}


def _update(record: _Record, heart: Heart, now_ns: int) -> str | None:
    """Update the record. Return a line for the log if the heart stopped or beats again, else
    None."""
    stood_s = (now_ns - record.moved_ns) / 1e9
    if heart.excused or heart.count != record.count:
        record.count, record.moved_ns = heart.count, now_ns
        if not record.stalled:
            return None
        record.stalled = False
        how = "is excused" if heart.excused else "moves again"
        return f"{heart.name} {how} after {stood_s:.1f} s ({record.stalls} stops so far)"
    if record.stalled or stood_s <= heart.within_s:
        return None
    record.stalled = True
    record.stalls += 1
    return f"{heart.name} has not moved for {stood_s:.1f} s (at count {heart.count})"
