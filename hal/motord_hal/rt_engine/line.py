# SPDX-License-Identifier: Apache-2.0
"""The line whose cycle runs in C: opened, set up, armed and watched from asyncio.

When asyncio is late, hogged or dead, the thread goes on: set-points that are old stop its drives.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Coroutine
from typing import Any

from motord_hal.clock import now_ns
from motord_hal.errors import DriveFault, HalError, NoReply, PortError, ProfileError
from motord_hal.modbus.parameter import readable, write_steps
from motord_hal.ports import (
    SETPOINT_TIMEOUT_S,
    DriveState,
    EventKind,
    LineEvent,
    LineSpec,
    LineState,
    LineStats,
    Listener,
)
from motord_hal.retry import Backoff
from motord_hal.rt import Exchange
from motord_hal.rt_engine.asks import Asks
from motord_hal.rt_engine.books import Books
from motord_hal.rt_engine.drive import RtDrive
from motord_hal.rt_engine.jobs import DriveJobs
from motord_hal.rt_engine.news import News
from motord_hal.rt_engine.protocols import frames_of
from motord_hal.rt_engine.table import line_table
from motord_hal.rt_line import DRIVES_MAX, LineReport, LineThread, ThreadSpec, check_table
from motord_hal.serial.counters import Witness
from motord_hal.serial.port import OpenPort, open_port

REOPEN_FIRST_S = 0.1
REOPEN_LIMIT_S = 2.0
SHUTDOWN_WITHIN_S = 0.6
"""The thread itself needs 0.5 s at most."""
SLOT_ALLOWANCE_S = 0.1
"""On top of the slowest cycle: lost replies of this drive or of its neighbours."""


class RtLine:
    """ports.Line for serial lines, engine "rt"."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        self.spec = spec
        self._listener = listener
        self._thread = LineThread(spec.index, exchange)
        frames = frames_of(spec)
        if len(frames) > DRIVES_MAX:
            raise ProfileError(f"{spec.name}: {len(frames)} drives, at most {DRIVES_MAX}")
        self._table = line_table(spec, frames)
        check_table(spec.name, self._table)
        self._news = News()
        self._witness = Witness()
        cycle_s = max(1.0 / spec.cycle_hz, sum(drive.slowest_cycle_s() for drive in frames))
        self._asks = Asks(spec.name, self._thread, len(frames) * (cycle_s + SLOT_ALLOWANCE_S))
        self._drives = [
            RtDrive(
                index,
                DriveJobs(index, drive, self._asks),
                spec.watchdog_s,
                self._thread,
                self._news,
                self._say,
                self._quiet_hint,
            )
            for index, drive in enumerate(frames)
        ]
        self._books = Books(1.0 / sum(drive.cycle_time_s() for drive in frames))
        self._port: OpenPort | None = None
        self._report: LineReport | None = None
        self._said_lost = False
        self._backoff = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S)

    # ------------------------------------------------------------------------------------ what is
    @property
    def engine(self) -> str:
        return "rt"

    @property
    def state(self) -> LineState:
        if self._report is None:
            return LineState.CLOSED
        if any(drive.state is DriveState.UNKNOWN for drive in self._drives):
            return LineState.CONFIGURING
        return LineState.READY

    @property
    def drive_states(self) -> dict[str, DriveState]:
        return {name: drive.state for drive in self._drives for name in drive.names}

    @property
    def drive_faults(self) -> dict[str, tuple[str, ...]]:
        return {name: watch.words for drive in self._drives for name, watch in drive.faults.items()}

    def stats(self) -> LineStats:
        """As ports.Line.stats, to this moment."""
        report = None if self._report is None else self._thread.report()
        return self._books.stats(report, self._thread)

    def _say(self, kind: EventKind, joints: tuple[str, ...], text: str) -> None:
        self._listener(LineEvent(kind, self.spec.name, joints, text))

    def _say_all(self, kind: EventKind, text: str) -> None:
        self._say(kind, tuple(joint.name for joint in self.spec.joints), text)

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """As ports.Line.run."""
        self._news.open()
        try:
            while True:
                await self._open()
                self._lose(await self._attend())
        finally:
            try:
                await self._shut_down()
            finally:
                self._close(PortError(f"{self.spec.name} is closed"))
                self._news.close()

    async def _open(self) -> None:
        if self._said_lost:
            await asyncio.sleep(self._backoff.next_s())
        while True:
            try:
                self._start()
                break
            except HalError as error:
                self._lose(error)
            await asyncio.sleep(self._backoff.next_s())
        if self._said_lost:
            self._books.reopened += 1
        self._said_lost = False
        facts = () if self._port is None else self._port.facts
        text = f"{self.spec.name} is open on {self.spec.port}"
        self._say_all(EventKind.LINE_OPEN, "; ".join((text, *facts)))

    def _start(self) -> None:
        """Raises HalError."""
        self._port = open_port(self.spec)
        direction = self.spec.direction
        thread = ThreadSpec(
            fd=self._port.fd,
            event_fd=self._news.event_fd,
            priority=self.spec.priority,
            cpu_mask=sum(1 << cpu for cpu in self.spec.cpu),
            de_fd=self._port.de_fd,
            de_active_high=direction.active_high,
            de_before_ns=round(direction.before_s * 1e9),
            de_after_ns=round(direction.after_s * 1e9),
        )
        self._thread.start(thread, self._table)
        self._report = self._thread.report()
        self._witness.forget()
        self._witness.look(self._port.fd)

    def _quiet_hint(self) -> str:
        if self._port is None or self._report is None:
            return ""
        return self._witness.hint(self._port.fd, self._report.noise_bytes)

    def _lose(self, error: HalError) -> None:
        self._books.count_port_error()
        self._close(error)
        if not self._said_lost:
            self._said_lost = True
            self._say_all(EventKind.LINE_LOST, f"{self.spec.name}: {error}")

    def _close(self, error: HalError) -> None:
        self._thread.stop()
        if self._report is not None:
            self._books.close(self._thread)
            self._report = None
        if self._port is not None:
            self._port.close()
            self._port = None
        self._asks.lose(error)
        for drive in self._drives:
            drive.lose(error)

    async def _attend(self) -> PortError:
        """Set up and watch the drives for as long as the thread runs; returns why it ended."""
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(task())
                for drive in self._drives
                for task in (drive.keep_set_up, drive.keep_powered_off)
            ]
            error = await self._watch()
            for task in tasks:
                task.cancel()
        return error

    async def _watch(self) -> PortError:
        while True:
            report = self._look()
            if not report.running:
                return PortError(f"{self.spec.port} went away: {os.strerror(report.error)}")
            if report.exchanges:
                self._backoff.reset()
            await self._news.wait()

    def _look(self) -> LineReport:
        """Take in what the thread says."""
        self._asks.take_answers()
        report = self._report = self._thread.report()
        for drive, said in zip(self._drives, report.drives, strict=True):
            drive.update(said, report.fault_words)
        if self._port is not None:
            self._witness.look(self._port.fd, report.noise_bytes)
        self._news.looked()
        return report

    async def _shut_down(self) -> None:
        """Quick stop, then power off, on every drive: C does it, and this waits for it."""
        if self._report is None:
            return
        self._thread.shut_down()
        try:
            async with asyncio.timeout(SHUTDOWN_WITHIN_S):
                while (report := self._thread.report()).running and not report.shut_down:
                    await self._news.wait()
        except TimeoutError:
            text = f"{self.spec.name}: not every drive was switched off at the end"
            self._say_all(EventKind.DRIVE_WARNING, text)

    # ---------------------------------------------------------------------------------- its orders
    async def arm(self) -> None:
        """As ports.Line.arm."""
        self._check_ready_to_arm()
        drives = [drive for drive in self._drives if drive.state is not DriveState.ARMED]
        armed = False
        try:
            await _all_of([drive.enable() for drive in drives])
            await _all_of([drive.go() for drive in drives])
            armed = True
        finally:
            if not armed:
                for drive in self._drives:
                    drive.stand_down()

    def _check_ready_to_arm(self) -> None:
        report = self._check_open()
        for drive in self._drives:
            if drive.state in (DriveState.QUIET, DriveState.UNKNOWN):
                raise NoReply(f"{drive} is {drive.state.value}: it cannot be armed")
            for name, watch in drive.faults.items():
                if watch.stopping:
                    raise DriveFault(f"{name} reports {', '.join(watch.words)}")
        age_ns = now_ns() - report.setpoints_ns
        if not report.setpoints_ns or age_ns > SETPOINT_TIMEOUT_S * 1e9:
            raise HalError(f"{self.spec.name}: no fresh set-points: is the loop running?")

    async def disarm(self) -> None:
        """As ports.Line.disarm. From the call on, every set-point is zero."""
        self._check_open()
        present = [drive for drive in self._drives if drive.state is not DriveState.QUIET]
        stopping = [asyncio.shield(drive.stand_down()) for drive in present]
        for result in await asyncio.gather(*stopping, return_exceptions=True):
            if isinstance(result, BaseException):
                raise result

    async def clear_faults(self) -> None:
        """As ports.Line.clear_faults. Drives without a fault are left as they are."""
        self._check_open()
        present = (DriveState.READY, DriveState.ARMED)
        await _all_of(
            [
                drive.clear_faults()
                for drive in self._drives
                if drive.state in present and any(watch.word for watch in drive.faults.values())
            ]
        )

    async def read_register(self, joint: str, register: str) -> float:
        """As ports.Line.read_register."""
        drive = self._drive_of(joint)
        found = readable(drive.frames.profile, register)
        self._check_open()
        return found.to_si(await drive.jobs.read(register))

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """As ports.Line.write_register."""
        drive = self._drive_of(joint)
        steps = write_steps(drive.frames.profile, register, value)
        self._check_open()
        await drive.jobs.run("write", steps)
        return drive.frames.profile.registers[register].to_si(steps[0].value or 0)

    def _drive_of(self, joint: str) -> RtDrive:
        for drive in self._drives:
            if joint in drive.names:
                return drive
        raise LookupError(f'{self.spec.name} has no joint "{joint}"')

    def _check_open(self) -> LineReport:
        """The newest report. Raises PortError where there is none."""
        if self._report is None:
            raise PortError(f"{self.spec.name} is not open on {self.spec.port}")
        self._report = self._thread.report()
        return self._report


async def _all_of(work: list[Coroutine[Any, Any, None]]) -> None:
    """All at once; the first HalError ends the others and is raised."""
    try:
        async with asyncio.TaskGroup() as group:
            for one in work:
                group.create_task(one)
    except* HalError as errors:
        first: BaseException = errors
        while isinstance(first, BaseExceptionGroup):
            first = first.exceptions[0]
        failed = first
    else:
        return
    raise failed
