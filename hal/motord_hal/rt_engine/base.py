# SPDX-License-Identifier: Apache-2.0
"""A line whose cycle runs in C: opened, set up, armed and watched from asyncio.

When asyncio is late, hogged or dead, the thread goes on: set-points that are old stop its drives.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
from collections.abc import Coroutine, Sequence
from typing import Any, Generic, Protocol, TypeVar

from motord_hal.clock import now_ns
from motord_hal.errors import DriveFault, HalError, NoReply, PortError
from motord_hal.ports import (
    SETPOINT_TIMEOUT_S,
    DriveState,
    EventKind,
    LineEvent,
    LineSpec,
    LineState,
    Listener,
)
from motord_hal.retry import Backoff
from motord_hal.rt_engine.drive import DriveSays, RtDrive
from motord_hal.rt_engine.news import News

REOPEN_FIRST_S = 0.1
REOPEN_LIMIT_S = 2.0
SHUTDOWN_WITHIN_S = 0.6
"""The thread itself needs 0.5 s at most."""


class LineSays(Protocol):
    """What every line's thread reports."""

    @property
    def running(self) -> bool: ...
    @property
    def shut_down(self) -> bool: ...
    @property
    def setpoints_ns(self) -> int: ...
    @property
    def fault_words(self) -> tuple[int, ...]: ...
    @property
    def drives(self) -> Sequence[DriveSays]: ...


Report = TypeVar("Report", bound=LineSays)
Said = TypeVar("Said", bound=LineSays, covariant=True)
AnyDrive = TypeVar("AnyDrive", bound=RtDrive)


class LineThreadDoor(Protocol[Said]):
    """A line's thread."""

    def stop(self) -> None: ...
    def shut_down(self) -> None: ...
    def report(self) -> Said: ...


class RtLineBase(abc.ABC, Generic[Report, AnyDrive]):
    """What lines of engine "rt" have in common, whatever their medium."""

    _thread: LineThreadDoor[Report]
    _drives: list[AnyDrive]

    def __init__(self, spec: LineSpec, listener: Listener) -> None:
        self.spec = spec
        self._listener = listener
        self._news = News()
        self._report: Report | None = None
        self._said_lost = False
        self._backoff = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S)

    # ------------------------------------------------------------------------------- its own medium
    @abc.abstractmethod
    async def _start(self) -> tuple[str, ...]:
        """Open the medium, start the thread, take its first report; what is worth saying of it.
        Raises HalError."""

    @abc.abstractmethod
    def _close_medium(self, error: HalError) -> None:
        """The thread has ended; its last report is still there."""

    @abc.abstractmethod
    def _look(self) -> Report:
        """Take in what the thread says."""

    @abc.abstractmethod
    def _ended(self, report: Report) -> PortError | None:
        """Why the line is lost; None: it works."""

    @abc.abstractmethod
    def _count_lost(self) -> None: ...

    @abc.abstractmethod
    def _count_reopened(self) -> None: ...

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
                facts = await self._start()
                break
            except HalError as error:
                self._lose(error)
            await asyncio.sleep(self._backoff.next_s())
        if self._said_lost:
            self._count_reopened()
        self._said_lost = False
        text = f"{self.spec.name} is open on {self.spec.port}"
        self._say_all(EventKind.LINE_OPEN, "; ".join((text, *facts)))

    def _lose(self, error: HalError) -> None:
        self._count_lost()
        self._close(error)
        if not self._said_lost:
            self._said_lost = True
            self._say_all(EventKind.LINE_LOST, f"{self.spec.name}: {error}")

    def _close(self, error: HalError) -> None:
        self._thread.stop()
        self._close_medium(error)
        self._report = None
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
            error = self._ended(self._look())
            if error is not None:
                return error
            await self._news.wait()

    def _take_report(self) -> Report:
        """The newest one, to its drives."""
        report = self._report = self._thread.report()
        for drive, said in zip(self._drives, report.drives, strict=True):
            drive.update(said, report.fault_words)
        return report

    async def _shut_down(self) -> None:
        """Quick stop, then power off, on every drive: C does it, and this waits for it."""
        if (report := self._report) is None:
            return
        self._thread.shut_down()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SHUTDOWN_WITHIN_S):
                while (report := self._thread.report()).running and not report.shut_down:
                    await self._news.wait()
        done = report.shut_down
        pairs = zip(self._drives, report.drives, strict=True)
        names = tuple(
            n for drive, said in pairs if said.stop_waits or not done for n in drive.names
        )
        if names:
            text = f"{self.spec.name}: {', '.join(names)} not switched off at the end"
            self._say(EventKind.DRIVE_WARNING, names, text)

    # ---------------------------------------------------------------------------------- its orders
    async def arm(self) -> None:
        """As ports.Line.arm."""
        self._check_ready_to_arm()
        drives = [drive for drive in self._drives if drive.state is not DriveState.ARMED]
        armed = False
        try:
            await all_of([drive.enable() for drive in drives])
            await all_of([drive.go() for drive in drives])
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
        await all_of(
            [
                drive.clear_faults()
                for drive in self._drives
                if drive.state in present and any(watch.word for watch in drive.faults.values())
            ]
        )

    def _drive_of(self, joint: str) -> AnyDrive:
        for drive in self._drives:
            if joint in drive.names:
                return drive
        raise LookupError(f'{self.spec.name} has no joint "{joint}"')

    def _check_open(self) -> Report:
        """The newest report. Raises PortError where there is none."""
        if self._report is None:
            raise PortError(f"{self.spec.name} is not open on {self.spec.port}")
        self._report = self._thread.report()
        return self._report


async def all_of(work: list[Coroutine[Any, Any, None]]) -> None:
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
