# SPDX-License-Identifier: Apache-2.0
"""The sums of the line counters over all threads that a line has had. Each thread counts from 0."""

from __future__ import annotations

from collections.abc import Sequence

from motord_hal.fieldbus.ports import LineStats, RoundTrips
from motord_hal.realtime.drive_state import Mode
from motord_hal.realtime.line import LineReport, LineThread

_ERRORS = ("no_reply", "bad_reply", "refused")


class LineCounters:
    """Adds the counters of earlier threads and of the present one."""

    def __init__(self, requested_hz: Sequence[float], wire_limit_hz: float) -> None:
        """`requested_hz`: cyclic rate that each drive should have."""
        self._requested_hz = tuple(requested_hz)
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
            requested_hz=max(self._requested_hz),
            wire_limit_hz=self._wire_limit_hz,
            round_trip=self._round_trip,
        )
        if report is not None:
            stats.exchanges += report.exchanges
            stats.cycles += _cycles(report)
            stats.errors = _with(self._errors, report)
            stats.cycle_hz, stats.requested_hz = self._rates_hz(report)
            stats.round_trip = thread.round_trips()
        return stats

    def _rates_hz(self, report: LineReport) -> tuple[float, float]:
        """Return the cyclic rate of the drive that falls behind most, among those that are ready or
        armed, and the rate requested of it. The first one is 0 if no drive has a rate."""
        rates_hz = [
            (1e9 / drive.cycle_ns, requested_hz)
            for drive, requested_hz in zip(report.drives, self._requested_hz, strict=True)
            if drive.mode in (Mode.READY, Mode.ARMED) and drive.cycle_ns
        ]
        behind = min(rates_hz, key=lambda rates: rates[0] / rates[1], default=None)
        return behind or (0.0, max(self._requested_hz))


def _cycles(report: LineReport) -> int:
    return max((drive.cycles for drive in report.drives), default=0)


def _with(errors: dict[str, int], report: LineReport) -> dict[str, int]:
    """Return the sums of `errors` and of the errors in the report, without counters of zero."""
    total = dict(errors)
    for kind in _ERRORS:
        count = sum(getattr(drive, kind) for drive in report.drives)
        if count:
            total[kind] = total.get(kind, 0) + count
    return total
