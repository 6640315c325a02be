# SPDX-License-Identifier: Apache-2.0
"""A CAN line whose cycle runs in C."""

from __future__ import annotations

import socket
from collections import Counter

from motord_hal.base.clock import now_s
from motord_hal.base.errors import PortError, ProfileError
from motord_hal.can.errors import BusTrouble, BusWarnings, error_words
from motord_hal.can.identifiers import ForeignSenders, can_plans
from motord_hal.can.interface import BUS_OFF_TEXT, BusOffWatch, make_ready
from motord_hal.can.plan import STEADY_S, wire_limit_hz
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.ports import EventKind, LineSpec, LineStats, Listener
from motord_hal.realtime.can import (
    DRIVES_MAX,
    ERROR,
    EXTENDED,
    SENDINGS_MAX,
    CanReport,
    CanThread,
    Received,
    check_table,
)
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.thread import cpu_mask
from motord_hal.rt_engine.base import RtLineBase
from motord_hal.rt_engine.can.drive import CanRtDrive
from motord_hal.rt_engine.can.jobs import CanJobs
from motord_hal.rt_engine.can.port import open_socket
from motord_hal.rt_engine.can.table import can_table, raw_identifier, table_sendings

_IDENTIFIER = 0x1FFF_FFFF


class RtCanLine(RtLineBase[CanReport, CanRtDrive]):
    """Implements ports.Line for the kind "can" with the engine "rt"."""

    _thread: CanThread

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        super().__init__(spec, listener)
        self._thread = CanThread(spec.index, exchange)
        self._plans = can_plans(spec)
        if len(self._plans) > DRIVES_MAX:
            raise ProfileError(f"{spec.name}: {len(self._plans)} drives, at most {DRIVES_MAX}")
        self._sendings = table_sendings(self._plans)
        if len(self._sendings) > SENDINGS_MAX:
            text = f"motord sends {len(self._sendings)} identifiers, at most {SENDINGS_MAX}"
            raise ProfileError(f"{spec.name}: {text}")
        self._table = can_table(spec, self._plans)
        check_table(spec.name, self._table)
        self._drives = [
            CanRtDrive(
                index,
                CanJobs(index, plan, self._thread, 1.0 / spec.cycle_hz, self._take_frames),
                spec,
                self._thread,
                self._notifier,
                self._say,
            )
            for index, plan in enumerate(self._plans)
        ]
        self._bus: socket.socket | None = None
        self._trouble: PortError | None = None
        self._bus_off = BusOffWatch(spec.port)
        self._errors: Counter[str] = Counter()
        self._warnings = BusWarnings()
        self._foreign = 0
        self._foreign_senders = ForeignSenders()
        self._frames = self._cycles = 0
        self._before = {"epoch": 0, "may_turn": 0, "left_running": int(spec.left_running)}
        """State of the drives that the next thread starts from. With `epoch` the feedback after a
        reopening counts as new, even if its counters look the same; `may_turn` marks the drives
        that were armed and may still turn."""

    def stats(self) -> LineStats:
        """Implement `ports.Line.stats`. `exchanges` counts the frames of the drives. There are no
        round trips, because most frames come without a request."""
        stats = LineStats(
            exchanges=self._frames,
            cycles=self._cycles,
            reopened=self._reopened,
            errors=dict(self._errors),
            requested_hz=self.spec.cycle_hz,
            wire_limit_hz=wire_limit_hz(self.spec, self._plans),
        )
        if self._report is not None:
            report = self._thread.report()
            stats.exchanges += report.received
            stats.cycles += report.cycles
            stats.cycle_hz = 1e9 / report.cycle_ns if report.cycle_ns else 0.0
            stats.errors = dict(self._errors + _errors(report))
        return stats

    # ----------------------------------------------------------------------------------- the socket
    async def _start(self) -> tuple[str, ...]:
        received = [one for plan in self._plans for one in plan.identifiers]
        identifiers = [number | EXTENDED * extended for number, extended in received]
        identifiers += map(raw_identifier, self._sendings)
        fd_frames = self.spec.data_baudrate is not None
        await make_ready(self.spec.port, self._errors, fd_frames=fd_frames)
        self._bus = open_socket(self.spec.port, identifiers, fd_frames=fd_frames)
        self._trouble = None
        self._thread.start(
            self._table,
            fd=self._bus.fileno(),
            event_fd=self._notifier.event_fd,
            priority=self.spec.priority,
            before=self._before,
            cpu_mask=cpu_mask(self.spec),
        )
        self._report = self._thread.report()
        return ()

    def _close_port(self) -> None:
        if self._report is not None:
            last = self._thread.report()
            self._foreign = 0
            self._frames += last.received
            self._cycles += last.cycles
            self._before |= {
                "epoch": max(drive.epoch for drive in last.drives),
                "may_turn": sum(one.may_turn << n for n, one in enumerate(last.drives)),
            }
            self._errors += _errors(last)
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _ended(self, report: CanReport) -> PortError | None:
        if self._trouble is not None:
            return self._trouble
        if self._bus_off.is_off():  # the error frame that reports it was lost
            self._errors["bus_off"] += 1
            return PortError(f"{self.spec.port}: {BUS_OFF_TEXT}")
        if not report.running:
            self._errors["port"] += 1
        return super()._ended(report)

    def _is_steady(self, report: CanReport) -> bool:
        return report.cycles > STEADY_S * self.spec.cycle_hz

    def _look(self) -> CanReport:
        """Extend `RtLineBase._look`: take the received frames first."""
        self._take_frames()
        report = super()._look()
        if report.foreign > self._foreign:
            sending = self._sendings[report.foreign_sending]
            self._warn(self._foreign_senders.new(sending, now_s()))
        self._foreign = report.foreign
        return report

    def _warn(self, text: str) -> None:
        if text:
            text = f"{self.spec.name}: {self.spec.port}: {text}"
            self._say_all(EventKind.DRIVE_WARNING, text)

    def _take_frames(self) -> None:
        while (received := self._thread.take()) is not None:
            if received.drive == DRIVES_MAX:
                self._note(received)
                continue
            found = self._plans[received.drive].parse(
                received.identifier & _IDENTIFIER,
                received.data,
                extended=received.identifier & EXTENDED != 0,
            )
            if found is None:
                self._errors["bad_frame"] += 1
                continue
            self._drives[received.drive].jobs.received(*found)

    def _note(self, received: Received) -> None:
        kinds, trouble = error_words(received.identifier & ~ERROR, received.data)
        self._errors.update(kinds)
        for warning in self._warnings.new(kinds, now_s()):
            self._warn(warning)
        if trouble is BusTrouble.BUS_OFF:
            self._trouble = PortError(f"{self.spec.port}: {BUS_OFF_TEXT}")
            self._notifier.poke()

    # ---------------------------------------------------------------------------------- parameters
    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register` for the signals of a CAN drive. If the drive sends
        the signal without a request, wait for its next frame."""
        jobs = self._drive_of(joint).jobs
        found = jobs.plan.readable(register)
        self._check_open()
        job = Job("read", (Step(register=register, mask=0, equals=0),))
        await jobs.finish(job)
        return found.to_si(job.raw)


def _errors(report: CanReport) -> Counter[str]:
    """Return the errors in a report by their kind, without counters of zero."""
    counts = {
        "tx_full": report.tx_full,
        "bad_frame": report.bad_frames,
        "unheard": report.dropped,
        "foreign": report.foreign,
    }
    return Counter({kind: count for kind, count in counts.items() if count})
