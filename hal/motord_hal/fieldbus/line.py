# SPDX-License-Identifier: Apache-2.0
"""What every line does, on each engine: open its medium, run, reopen, shut down. However a line
ends, its drives are brought to rest before its medium is closed.

A kind of line turns the errors of its medium into HalErrors. One that it misses is a bug, but costs
no more than a lost medium does: the daemon and its other lines go on.
"""

from __future__ import annotations

import abc
import asyncio
import logging
from collections.abc import Mapping, Sequence
from typing import Generic, Protocol, TypeVar

from motord_hal.base.errors import SYSTEM_ERRORS, DriveFault, HalError, NoReply, PortError, first_of
from motord_hal.base.retry import Backoff
from motord_hal.fieldbus.faults import FaultWatch
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    LineEvent,
    LineSpec,
    LineState,
    Listener,
)
from motord_hal.fieldbus.trace import Trace
from motord_hal.realtime.exchange import is_fresh

REOPEN_FIRST_S = 0.1
REOPEN_LIMIT_S = 2.0
SETPOINT_LOOK_EVERY_S = 0.02
SETPOINT_LOOKS = 50
"""Number of looks for fresh set-points before arming is refused. It is not a time, because what
delays the loop may delay this process, too."""
NO_SETPOINTS = "no fresh set-points: is the loop running?"
PRESENT = (DriveState.READY, DriveState.ARMED)
"""States of a drive that is set up and responds."""

_log = logging.getLogger(__name__)


class DriveOnLine(Protocol):
    """The interface that a line needs from each of its drives, on each engine."""

    @property
    def state(self) -> DriveState: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def faults(self) -> Mapping[str, FaultWatch]: ...
    @property
    def is_stopping(self) -> bool: ...
    def lose(self, error: HalError) -> None: ...
    def stand_down(self) -> object: ...


class LineTask(abc.ABC):
    """The task of a line: it opens the medium, uses it, reopens it after a loss, and closes it."""

    _drives: Sequence[DriveOnLine] = ()
    """Empty if only the thread in C handles the drives."""

    def __init__(self, spec: LineSpec, listener: Listener) -> None:
        self.spec = spec
        self._listener = listener
        self.trace: Trace | None = None
        self._is_open = False
        self._reported_lost = False
        self._losses = 0
        """How often the medium was lost, or could not be opened."""
        self._reopened = 0
        self._logged_bug = ""
        # drives that were left running have to be stopped soon: no try may be far from the next
        limit_s = REOPEN_FIRST_S if spec.left_running else REOPEN_LIMIT_S
        self._backoff = Backoff(REOPEN_FIRST_S, limit_s)

    # ----------------------------------------------------------------------------------- the medium
    @abc.abstractmethod
    async def _open_medium(self) -> str:
        """Open the medium, with a deadline; return the text of its event. Raise HalError on
        failure. After that, or a cancellation, `_close_medium` closes what was opened."""

    @abc.abstractmethod
    async def _work(self) -> None:
        """Run the drives until the medium is lost; then raise PortError with the reason."""

    @abc.abstractmethod
    async def _shut_down(self) -> None:
        """Stop every drive, then power it off, within a deadline; report what fails."""

    @abc.abstractmethod
    def _close_medium(self) -> None:
        """Close the medium. Do nothing if it is not open."""

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """Implement `ports.Line.run`. Shut the drives down also if a bug ends the task."""
        try:
            while True:
                await self._open()
                await self._work_until_lost()
        finally:
            try:
                if self._is_open:
                    await self._shut_down_surely()
            finally:
                self._close(PortError(f"{self.spec.name} is closed"))

    async def _work_until_lost(self) -> None:
        try:
            await self._work()
        except* (HalError, *SYSTEM_ERRORS) as group:
            error = first_of(group)
        task = asyncio.current_task()
        if task is not None and task.cancelling():  # a group of tasks drops it for an error
            raise asyncio.CancelledError
        if not isinstance(error, PortError):
            error = self._bug(error)
            self._report_loss(error)  # the other lines stop meanwhile
            await self._shut_down_surely()  # the medium may be in order
        self._lose(error)

    async def _shut_down_surely(self) -> None:
        """Shut the drives down. If that fails, report that they may still have power."""
        try:
            await self._shut_down()
        except SYSTEM_ERRORS as error:
            text = f"{self.spec.name}: not switched off at the end: {self._bug(error)}"
            self._say_all(EventKind.DRIVE_LEFT_ON, text)

    async def _open(self) -> None:
        while True:
            if self._reported_lost:
                await asyncio.sleep(self._backoff.next_s())
            try:
                text = await self._open_medium()
                break
            except HalError as error:
                self._lose(error)
            except SYSTEM_ERRORS as error:
                self._lose(self._bug(error))
        self._reopened += self._reported_lost
        self._is_open, self._reported_lost = True, False
        self._say_all(EventKind.LINE_OPEN, text)

    def _lose(self, error: HalError) -> None:
        self._losses += 1
        self._close(error)
        self._report_loss(error)

    def _report_loss(self, error: HalError) -> None:
        if not self._reported_lost:
            self._reported_lost = True
            self._say_all(EventKind.LINE_LOST, f"{self.spec.name}: {error}")

    def _close(self, error: HalError) -> None:
        """Close the medium, and raise `error` in the callers that wait for a drive."""
        self._is_open = False
        try:
            self._close_medium()
        except (HalError, *SYSTEM_ERRORS) as failure:
            self._bug(failure)
        for drive in self._drives:
            drive.lose(error)

    def _bug(self, error: BaseException) -> PortError:
        """Log an error that a kind of line should have handled; the same one once. Return it as the
        loss of the medium."""
        text = f"{type(error).__name__}: {error}"
        if text != self._logged_bug:
            self._logged_bug = text
            _log.error("%s: a bug of motord: please report it", self.spec.name, exc_info=error)
        return PortError(f"{text} (a bug of motord: see the log)")

    # ------------------------------------------------------------------------------------ events
    def _say(self, kind: EventKind, joints: tuple[str, ...], text: str) -> None:
        self._listener(LineEvent(kind, self.spec.name, joints, text))

    def _say_all(self, kind: EventKind, text: str) -> None:
        self._say(kind, tuple(joint.name for joint in self.spec.joints), text)

    def _check_open(self) -> None:
        """Raise PortError if the medium is not open."""
        if not self._is_open:
            raise PortError(f"{self.spec.name} is not open on {self.spec.port}")


AnyDrive = TypeVar("AnyDrive", bound=DriveOnLine)


class DriveLine(LineTask, Generic[AnyDrive]):
    """A line with drives that answer, each with one or more joints."""

    _drives: Sequence[AnyDrive]

    @property
    def state(self) -> LineState:
        if not self._is_open:
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

    def is_stopping(self, joint: str) -> bool:
        """Whether the joint's drive was sent a quick stop, and no power-off since."""
        return self._drive_of(joint).is_stopping

    def _say_left_on(self, drives: Sequence[AnyDrive], why: str = "") -> None:
        """Report drives that may still have power when the medium is closed."""
        for drive in drives:
            text = f"{self.spec.name}: {', '.join(drive.names)} not switched off at the end"
            self._say(EventKind.DRIVE_LEFT_ON, drive.names, ": ".join(filter(None, (text, why))))

    # -------------------------------------------------------------------------- parts of the engine
    @abc.abstractmethod
    def _setpoints_ns(self) -> int:
        """Return the stamp of the newest set-points."""

    @abc.abstractmethod
    async def _arm(self, drives: Sequence[AnyDrive]) -> None:
        """Enable these drives, at zero speed. Raise the first HalError."""

    @abc.abstractmethod
    async def _stand_down(self, drives: Sequence[AnyDrive]) -> None:
        """Send zero speed and power-off to these drives. Begin on all of them at once, and go on if
        the caller gives up. Raise the first HalError when all have ended."""

    @abc.abstractmethod
    async def _clear(self, drives: Sequence[AnyDrive]) -> None:
        """Power these drives off, then run the fault-clearing steps. Raise the first HalError."""

    @abc.abstractmethod
    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register`."""

    # ------------------------------------------------------------------------------------ commands
    async def arm(self) -> None:
        """Implement `ports.Line.arm`. If one drive cannot be armed, disarm all."""
        await self._be_ready_to_arm()
        armed = False
        try:
            await self._arm([one for one in self._drives if one.state is not DriveState.ARMED])
            armed = True
        finally:
            if not armed:
                for drive in self._drives:
                    drive.stand_down()

    async def _be_ready_to_arm(self) -> None:
        """Wait until the loop sends fresh set-points: without them no drive is armed, and a delayed
        loop sends some soon. Raise HalError if none come, or a drive cannot be armed."""
        for _ in range(SETPOINT_LOOKS):
            self._check_open()
            setpoints_ns = self._setpoints_ns()
            self._check_drives()
            if is_fresh(setpoints_ns, self.spec.setpoint_timeout_s):
                return
            await asyncio.sleep(SETPOINT_LOOK_EVERY_S)
        raise HalError(f"{self.spec.name}: {NO_SETPOINTS}")

    def _check_drives(self) -> None:
        """Raise HalError if a drive cannot be armed."""
        for drive in self._drives:
            if drive.state not in PRESENT:
                raise NoReply(f"{drive} is {drive.state.value}: it cannot be armed")
            if drive.is_stopping:
                raise HalError(f"{drive} is still stopping: it cannot be armed")
            for name, watch in drive.faults.items():
                if watch.stopping:
                    raise DriveFault(f"{name} reports {', '.join(watch.words)}")

    async def disarm(self) -> None:
        """Implement `ports.Line.disarm`. From the call on, every set-point is zero."""
        self._check_open()
        there = [one for one in self._drives if one.state is not DriveState.UNRESPONSIVE]
        await self._stand_down(there)
        if silent := [one for one in self._drives if one not in there]:
            names = ", ".join(name for drive in silent for name in drive.names)
            raise NoReply(f"{names}: no answer, so the power-off is not confirmed")

    async def clear_faults(self) -> None:
        """Implement `ports.Line.clear_faults`. Leave drives without a fault as they are."""
        self._check_open()
        faulty = [one for one in self._drives if any(watch.word for watch in one.faults.values())]
        await self._clear([drive for drive in faulty if drive.state in PRESENT])

    def _drive_of(self, joint: str) -> AnyDrive:
        for drive in self._drives:
            if joint in drive.names:
                return drive
        raise LookupError(f'{self.spec.name} has no joint "{joint}"')
