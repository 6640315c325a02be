# SPDX-License-Identifier: Apache-2.0
"""A serial line whose cycle runs in C."""

from __future__ import annotations

from dataclasses import replace

from motord_hal.base.errors import HalError, ProfileError
from motord_hal.fieldbus.parameter import readable
from motord_hal.fieldbus.ports import LineSpec, LineStats, Listener
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.line import DRIVES_MAX, LineReport, LineThread, ThreadSpec, check_table
from motord_hal.rt_engine.base import RtLineBase
from motord_hal.rt_engine.counters import LineCounters
from motord_hal.rt_engine.rs485.drive import SerialDrive
from motord_hal.rt_engine.rs485.jobs import DriveJobs
from motord_hal.rt_engine.rs485.protocols import frames_of
from motord_hal.rt_engine.rs485.request_queue import RequestQueue
from motord_hal.rt_engine.rs485.servo_frames import cycle_of_all_s
from motord_hal.rt_engine.rs485.table import late_ns, line_table
from motord_hal.serial.counters import Traffic, Witness
from motord_hal.serial.port import OpenPort, open_port
from motord_hal.serial.settings import is_pty

SLOT_ALLOWANCE_S = 0.3
"""Time that a request may wait beyond the slowest cycle, for lost replies of any drive and for the
silence in which a late reply may still come."""


class RtLine(RtLineBase[LineReport, SerialDrive]):
    """Implements ports.Line for serial lines with the engine "rt"."""

    _thread: LineThread

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        super().__init__(spec, listener)
        self._thread = LineThread(spec.index, exchange)
        frames = frames_of(spec)
        if len(frames) > DRIVES_MAX:
            raise ProfileError(f"{spec.name}: {len(frames)} drives, at most {DRIVES_MAX}")
        self._table = line_table(spec, frames)
        check_table(spec.name, self._table)
        self._witness = Witness()
        cycle_s = max(1.0 / spec.cycle_hz, sum(drive.slowest_cycle_s() for drive in frames))
        self._queue = RequestQueue(
            spec.name, self._thread, len(frames) * (cycle_s + SLOT_ALLOWANCE_S)
        )
        self._drives = [
            SerialDrive(
                index,
                DriveJobs(index, drive, self._queue),
                spec,
                self._thread,
                self._notifier,
                self._say,
                self._unresponsive_hint,
            )
            for index, drive in enumerate(frames)
        ]
        requested_hz = [1e9 / drive.period_ns for drive in self._table.drive]
        self._counters = LineCounters(requested_hz, 1.0 / cycle_of_all_s(frames))
        self._port: OpenPort | None = None
        self._may_turn = 0
        """Bit n is 1 if drive n may have been moving when the port was lost."""

    def stats(self) -> LineStats:
        """Implement `ports.Line.stats`."""
        report = None if self._report is None else self._thread.report()
        stats = self._counters.stats(report, self._thread)
        stats.reopened = self._reopened
        if self._losses:
            stats.errors["port"] = self._losses
        return stats

    async def _start(self) -> tuple[str, ...]:
        self._port = open_port(self.spec)
        thread = ThreadSpec.of(
            self.spec,
            fd=self._port.fd,
            de_fd=self._port.de_fd,
            event_fd=self._notifier.event_fd,
            may_turn=self._may_turn,
        )
        late = late_ns(is_pty=is_pty(self._port.fd))
        self._thread.start(thread, replace(self._table, late_ns=late))
        self._report = self._thread.report()
        self._witness.forget()
        self._witness.look(self._port.fd)
        return self._port.facts

    def _unresponsive_hint(self) -> str:
        if self._port is None or self._report is None:
            return ""
        return self._witness.hint(self._port.fd, _traffic(self._report))

    def _close_port(self) -> None:
        if self._report is not None:
            drives = self._thread.report().drives
            self._may_turn = sum(one.may_turn << n for n, one in enumerate(drives))
            self._counters.close(self._thread)
        if self._port is not None:
            self._port.close()
            self._port = None

    def _close(self, error: HalError) -> None:
        super()._close(error)
        self._queue.lose(error)

    def _is_steady(self, report: LineReport) -> bool:
        return report.exchanges > 0

    def _look(self) -> LineReport:
        """Extend `RtLineBase._look`: take the answers first."""
        self._queue.take_answers()
        report = self._take_report()
        if self._port is not None:
            self._witness.look(self._port.fd, _traffic(report))
        return report

    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register`."""
        drive = self._drive_of(joint)
        found = readable(drive.jobs.profile, register)
        self._check_open()
        return found.to_si(await drive.jobs.read(register))


def _traffic(report: LineReport) -> Traffic:
    late = sum(drive.late for drive in report.drives)
    return Traffic(noise_bytes=report.noise_bytes, frames=report.answers, late=late)
