# SPDX-License-Identifier: Apache-2.0
"""The sums of the line counters over all threads that a line has had. Each thread counts from 0."""

from __future__ import annotations

from motord_hal.fieldbus.ports import LineStats, RoundTrips
from motord_hal.realtime.drive_state import Mode
from motord_hal.realtime.line import LineReport, LineThread

_ERRORS = ("no_reply", "bad_reply", "refused")


class LineCounters:
    """Adds the counters of earlier threads and of the present one."""

    def __init__(self, wire_limit_hz: float) -> None:
        self._wire_limit_hz = wire_limit_hz
        self._exchanges = 0
        self._cycles = 0
        self._errors: dict[str, int] = {}
        self._round_trip = RoundTrips()

    def close(self, thread: LineThread) -> None:
        """Add the counters of a thread that has ended."""
        report = thread.report()
        self._exchanges += report.exchanges
        self._cycles += _cycles(report)
        self._errors = _with(self._errors, report)
        self._round_trip = thread.round_trips()

    def stats(self, report: LineReport | None, thread: LineThread) -> LineStats:
        """Return the sums, without what the line itself counts (reopenings, port errors). `report`:
        of the thread; None if no thread runs."""
        stats = LineStats(
            exchanges=self._exchanges,
            cycles=self._cycles,
            errors=dict(self._errors),
            wire_limit_hz=self._wire_limit_hz,
            round_trip=self._round_trip,
        )
        if report is not None:
            stats.exchanges += report.exchanges
            stats.cycles += _cycles(report)
            stats.errors = _with(self._errors, report)
            stats.cycle_hz = _cycle_hz(report)
            stats.round_trip = thread.round_trips()
        return stats


def _cycles(report: LineReport) -> int:
    return max((drive.cycles for drive in report.drives), default=0)


def _cycle_hz(report: LineReport) -> float:
    """Return the cyclic rate of the slowest drive that is ready or armed; 0: no drive is."""
    asked = (drive for drive in report.drives if drive.mode in (Mode.READY, Mode.ARMED))
    slowest_ns = max((drive.cycle_ns for drive in asked), default=0)
    return 1e9 / slowest_ns if slowest_ns else 0.0


def _with(errors: dict[str, int], report: LineReport) -> dict[str, int]:
    """Return the sums of `errors` and of the errors in the report, without counters of zero."""
    total = dict(errors)
    for kind in _ERRORS:
        count = sum(getattr(drive, kind) for drive in report.drives)
        if count:
            total[kind] = total.get(kind, 0) + count
    return total
