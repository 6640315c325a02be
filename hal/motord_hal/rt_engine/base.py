# SPDX-License-Identifier: Apache-2.0
"""A line whose cycle runs in a thread in C. From asyncio it is opened, set up, armed and watched.

When asyncio is late, hogged or dead, the thread goes on: it stops its drives when set-points are
old.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
import os
from collections.abc import Coroutine, Sequence
from typing import Any, Generic, Protocol, TypeVar

from motord_hal.base.clock import within
from motord_hal.base.errors import HalError, PortError, first_of
from motord_hal.base.tasks import TaskGroup
from motord_hal.fieldbus.line import DriveLine
from motord_hal.fieldbus.parameter import write_steps
from motord_hal.fieldbus.ports import LineSpec, Listener
from motord_hal.realtime.thread import AnyLineReport
from motord_hal.realtime.trace import RtTrace
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.drive import RtDrive

SHUTDOWN_WITHIN_S = 3.1
"""Deadline for the shut-down. The thread itself needs 0.5 s, 1 s if drives report that they still
have power, and 3 s at most if they do not answer."""


Report = TypeVar("Report", bound=AnyLineReport)
ReportOut = TypeVar("ReportOut", bound=AnyLineReport, covariant=True)
AnyDrive = TypeVar("AnyDrive", bound=RtDrive)


class ReportingThread(Protocol[ReportOut]):
    """The interface that RtLineBase needs from the thread of its line."""

    def stop(self) -> None: ...
    def shut_down(self) -> None: ...
    def report(self) -> ReportOut: ...


class RtLineBase(DriveLine[AnyDrive], Generic[Report, AnyDrive]):
    """The part that all lines of the engine "rt" share, on every medium."""

    _thread: ReportingThread[Report]

    def __init__(self, spec: LineSpec, listener: Listener) -> None:
        super().__init__(spec, listener)
        self.trace = RtTrace(spec.index)
        self._notifier = Notifier()
        self._report: Report | None = None

    @property
    def engine(self) -> str:
        return "rt"

    # ------------------------------------------------------------------------------------- the port
    @abc.abstractmethod
    async def _start(self) -> tuple[str, ...]:
        """Open the port, start the thread, take its first report. Return facts for the user, which
        the event LINE_OPEN shows. Raise HalError if it fails."""

    @abc.abstractmethod
    def _close_port(self) -> None:
        """Close the port. It is called after the thread has ended; the last report of the thread
        can still be read."""

    @abc.abstractmethod
    def _is_steady(self, report: Report) -> bool:
        """Whether the line works well enough to reset the back-off, so that it is reopened at once
        after its next failure."""

    def _look(self) -> Report:
        """Read the thread's newest report and pass it on."""
        return self._take_report()

    def _ended(self, report: Report) -> PortError | None:
        """Return the reason why the line is lost; None: it works."""
        if not report.running:
            return PortError(f"{self.spec.port} went away: {os.strerror(report.error)}")
        if self._is_steady(report):
            self._backoff.reset()
        return None

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """Implement `ports.Line.run`."""
        self._notifier.open()
        try:
            await super().run()
        finally:
            self._notifier.close()

    async def _open_medium(self) -> str:
        facts = await self._start()
        return "; ".join((f"{self.spec.name} is open on {self.spec.port}", *facts))

    def _close_medium(self) -> None:
        self._thread.stop()
        self._close_port()
        self._report = None

    async def _work(self) -> None:
        """Set up and watch the drives while the thread runs; then raise PortError with the reason
        for its end."""
        async with TaskGroup() as group:
            tasks = [
                group.create_task(task())
                for drive in self._drives
                for task in (drive.keep_set_up, drive.keep_powered_off)
            ]
            error = await self._watch()
            for task in tasks:
                task.cancel()
        raise error

    async def _watch(self) -> PortError:
        while True:
            report = self._look()
            self._notifier.looked()
            if (error := self._ended(report)) is not None:
                return error
            await self._notifier.wait()

    def _take_report(self) -> Report:
        """Read the newest report and pass it to the drives."""
        report = self._report = self._thread.report()
        for drive, drive_report in zip(self._drives, report.drives, strict=True):
            drive.update(drive_report, report.fault_words)
        return report

    async def _shut_down(self) -> None:
        """Request a quick stop and then a power-off of every drive, and wait until the thread in C
        has done it. Report the drives for which it is not confirmed."""
        self._thread.shut_down()
        report = self._thread.report()
        with contextlib.suppress(TimeoutError):
            async with within(SHUTDOWN_WITHIN_S):
                while (report := self._thread.report()).running and not report.shut_down:
                    await self._notifier.wait()
        done = report.shut_down
        pairs = zip(self._drives, report.drives, strict=True)
        self._say_left_on(
            [drive for drive, drive_report in pairs if drive_report.stop_waits or not done],
            "it was not confirmed",
        )

    # ------------------------------------------------------------------------------------ commands
    def _setpoints_ns(self) -> int:
        return self._take_report().setpoints_ns

    async def _arm(self, drives: Sequence[AnyDrive]) -> None:
        began = [(drive, drive.stops) for drive in drives]
        await all_of([drive.enable(stops) for drive, stops in began])
        await all_of([drive.go(stops) for drive, stops in began])

    async def _stand_down(self, drives: Sequence[AnyDrive]) -> None:
        stopping = [asyncio.shield(drive.stand_down()) for drive in drives]
        for result in await asyncio.gather(*stopping, return_exceptions=True):
            if isinstance(result, BaseException):
                raise result

    async def _clear(self, drives: Sequence[AnyDrive]) -> None:
        await all_of([drive.clear_faults() for drive in drives])

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """Implement `ports.Line.write_register`."""
        drive = self._drive_of(joint)
        steps = write_steps(drive.profile, register, value)
        self._check_open()
        return await drive.write_register(register, steps)


async def all_of(work: list[Coroutine[Any, Any, None]]) -> None:
    """Run all coroutines at the same time. The first HalError ends the others and is raised."""
    try:
        async with TaskGroup() as group:
            for one in work:
                group.create_task(one)
    except* HalError as errors:
        failed = first_of(errors)
    else:
        return
    raise failed
