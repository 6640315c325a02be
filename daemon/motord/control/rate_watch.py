# SPDX-License-Identifier: Apache-2.0
"""Logs the lines whose cyclic rate stays behind the one that the robot file requests. Pure: time is
an argument."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

ENOUGH = 0.95
"""A line with this part of its rate has it: rates are smoothed, and vary with other requests."""
BEHIND_S = 5.0
"""A line is reported after it was behind for this long: arming, set-ups and a busy computer cost
some cycles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineRate:
    """The rate of one line. `cycle_hz` 0: no drive has one now."""

    line: str
    cycle_hz: float
    requested_hz: float


@dataclass(slots=True)
class _Record:
    since_ns: int | None = None
    """Time since when the line is behind; None: it is not."""
    reported: bool = False


class RateWatch:
    """Record of which lines are behind."""

    def __init__(self) -> None:
        self._records: dict[str, _Record] = {}

    def look(self, now_ns: int, rates: Iterable[LineRate]) -> list[str]:
        """Return a line for the log for each change since the last look."""
        messages = []
        for rate in rates:
            record = self._records.setdefault(rate.line, _Record())
            if rate.cycle_hz >= ENOUGH * rate.requested_hz:
                if record.reported:
                    messages.append(f"line {rate.line} reaches its {rate.requested_hz:g} Hz again")
                self._records[rate.line] = _Record()
            elif rate.cycle_hz <= 0.0:
                record.since_ns = None  # it has no rate: what was reported still holds
            elif record.since_ns is None:
                record.since_ns = now_ns
            elif not record.reported and now_ns - record.since_ns >= BEHIND_S * 1e9:
                record.reported = True
                messages.append(_behind(rate))
        return messages


def _behind(rate: LineRate) -> str:
    return (
        f"line {rate.line} reaches {rate.cycle_hz:.3g} of {rate.requested_hz:g} Hz: its drives "
        "answer too late for this rate, or not at all. Set a cycle_hz that it reaches: "
        "docs/rs485.md"
    )
