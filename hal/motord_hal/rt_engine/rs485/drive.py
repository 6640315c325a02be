# SPDX-License-Identifier: Apache-2.0
"""One drive of a real-time line: it is set up, armed and disarmed here, and watched.

Its cycle and its stops are in C (api_line.h). Here are only requests, which C carries out if that
is safe, and sequences of requests.
"""

from __future__ import annotations

import abc
import asyncio
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any, Protocol

from motord_hal.base.clock import NS_PER_S, now_ns, within
from motord_hal.base.errors import HalError, PortError
from motord_hal.base.retry import Backoff
from motord_hal.drives.profile import DriveProfile, Step
from motord_hal.fieldbus.faults import STILL_ENABLED_TEXT, FaultWatch, Say
from motord_hal.fieldbus.job import VERIFY_WITHIN_S, clear_steps, configure_steps, kept_steps
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec
from motord_hal.realtime.drive_state import FaultReason, Mode
from motord_hal.realtime.line import AnswerKind, DriveReport, LineThread
from motord_hal.realtime.thread import AnyDriveReport, LineThreadHandle
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.jobs import DriveJobs
from motord_hal.rt_engine.rs485.request_queue import Check, exception_text

RETRY_FIRST_S = 0.1
RETRY_LIMIT_S = 2.0
OBEYED_WITHIN_S = 1.0
"""C carries out or refuses a request within milliseconds; asyncio may learn of it later."""

_STATES = MappingProxyType(
    {
        Mode.OFF: DriveState.UNKNOWN,
        Mode.READY: DriveState.READY,
        Mode.ARMED: DriveState.ARMED,
        Mode.UNRESPONSIVE: DriveState.UNRESPONSIVE,
        Mode.BACK: DriveState.UNKNOWN,
    }
)
_WARNINGS = MappingProxyType(
    {
        FaultReason.LOST_SETUP: "has lost its set-up: set up again, disarmed",
        FaultReason.DISABLED_ITSELF: "is not enabled any more: set up again, disarmed",
        FaultReason.POSITION_UNKNOWN: "gets no power: its position is unknown, too old, out "
        "of its range, or far from its first target: check zero_count",
        FaultReason.STILL_ENABLED: STILL_ENABLED_TEXT,
    }
)


class Jobs(Protocol):
    """Sequences of steps with one drive, beside its cycle."""

    profile: DriveProfile
    joints: tuple[JointSpec, ...]
    unit: int

    @property
    def request_limit_s(self) -> float:
        """Longest time until a request is on the wire or dropped."""
        ...

    async def run(
        self, name: str, steps: Sequence[Step], *, urgent: bool = ..., check: Check = ...
    ) -> None: ...


class RtDrive(abc.ABC):
    """Number `index` of the line's table."""

    def __init__(
        self,
        index: int,
        jobs: Jobs,
        watchdog_s: float,
        thread: LineThreadHandle,
        notifier: Notifier,
        say: Say,
    ) -> None:
        self._jobs = jobs
        self.names = tuple(joint.name for joint in jobs.joints)
        self.faults = {name: FaultWatch(name, jobs.profile, say) for name in self.names}
        self._index = index
        self._setup = configure_steps(jobs.profile, watchdog_s)
        self._thread = thread
        self._notifier = notifier
        self._say = say
        self._report: AnyDriveReport | None = None
        self._backoff = Backoff(RETRY_FIRST_S, RETRY_LIMIT_S)
        self._failed_setup = False
        self._reported_unresponsive = False
        self.stops = 0
        """How often it was stood down: this ends an arming that began before."""
        self._standing_down = 0
        """The last request that did so."""
        self._powering_off: asyncio.Future[None] | None = None

    def __str__(self) -> str:
        return f"{', '.join(self.names)} (unit {self._jobs.unit})"

    @abc.abstractmethod
    def _why_unresponsive(self, report: Any) -> str:
        """The report in words."""

    @abc.abstractmethod
    def _arming_steps(self) -> tuple[Step, ...]:
        """Zero in its set-points, then the profile's steps, until it reports that it is enabled."""

    def _hint(self) -> str:
        """Other possible reasons, from its medium."""
        return ""

    @abc.abstractmethod
    async def _present(self) -> None:
        """Returns when it responds, if its medium shows that before the set-up."""

    # --------------------------------------------------------------------------------- what it is
    @property
    def profile(self) -> DriveProfile:
        return self._jobs.profile

    @property
    def mode(self) -> Mode:
        return Mode.OFF if self._report is None else self._report.mode

    @property
    def state(self) -> DriveState:
        state = _STATES[self.mode]
        failed = state is DriveState.UNKNOWN and self._failed_setup
        return DriveState.UNRESPONSIVE if failed else state

    @property
    def is_stopping(self) -> bool:
        """A quick stop was sent, and the wheel has not been seen at rest since."""
        return self._report is not None and self._report.stopping

    def lose(self, error: HalError) -> None:
        """The line is lost; the drive's state is unknown."""
        self._report = None
        self._failed_setup = False
        self.stops += 1
        self._powered_off(error)

    def update(self, report: AnyDriveReport, fault_words: Sequence[int]) -> None:
        """Note what C reports, and report changes."""
        before = self.mode
        before_reasons = FaultReason(0) if self._report is None else self._report.fault_reasons
        self._report = report
        if report.cycles:  # else its fault words have not been read
            for joint in self._jobs.joints:
                self.faults[joint.name].update(fault_words[joint.index])
        # states between two looks are not seen: it may have been unresponsive in the first
        if report.mode is Mode.READY and before not in (Mode.READY, Mode.ARMED):
            self._is_ready()
        elif report.mode in (Mode.UNRESPONSIVE, Mode.BACK):
            self._is_unresponsive(self._why_unresponsive(report))
        for bit in report.fault_reasons & ~before_reasons:
            if bit in _WARNINGS:
                self._say(EventKind.DRIVE_WARNING, self.names, f"{self} {_WARNINGS[bit]}")

    def _is_ready(self) -> None:
        self._backoff.reset()
        if self._reported_unresponsive:
            self._say(EventKind.DRIVE_BACK, self.names, f"{self} is back, configured and disarmed")
        else:
            self._say(EventKind.DRIVE_READY, self.names, f"{self} is configured and disarmed")
        self._reported_unresponsive = False

    def _is_unresponsive(self, why: str) -> None:
        if not self._reported_unresponsive:
            self._reported_unresponsive = True
            cause = "; ".join(filter(None, (why, self._hint())))
            self._say(EventKind.DRIVE_UNRESPONSIVE, self.names, f"{self} is unresponsive: {cause}")

    # -------------------------------------------------------------------------------- its two tasks
    async def keep_set_up(self) -> None:
        """Whenever C reports that it is not set up: set it up, and request READY. Never returns."""
        while True:
            await self._notifier.until(lambda: self.mode in (Mode.OFF, Mode.BACK))
            try:
                await self._present()
                self._failed_setup = False
                await self._jobs.run("configure", self._setup)
                await self._obeyed(self._thread.request_mode(self._index, Mode.READY))
                continue
            except PortError:
                pass  # the line has noticed it, too, and ends this task
            except HalError as error:
                self._failed_setup = True
                self._is_unresponsive(str(error))
            await asyncio.sleep(self._backoff.next_s())

    async def keep_powered_off(self) -> None:
        """Whenever it was stood down: power off, ahead of all other requests. Never returns."""
        while True:
            await self._notifier.until(lambda: self._powering_off is not None)
            try:
                await self._jobs.run("disarm", self._jobs.profile.disarm, urgent=True)
                await self._obeyed(self._standing_down)
            except HalError as error:
                self._powered_off(error)
            else:
                self._powered_off(None)

    def _powered_off(self, error: HalError | None) -> None:
        future, self._powering_off = self._powering_off, None
        if future is None:
            return
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(error)
            future.exception()  # perhaps no caller waits for it

    async def _obeyed(self, request: int) -> None:
        """Wait until C has carried the request out, or refused it. Raises HalError."""
        try:
            async with within(OBEYED_WITHIN_S):
                await self._notifier.until(
                    lambda: self._report is not None and self._report.request_seen >= request
                )
        except TimeoutError:
            raise HalError(f"{self}: the line's thread does not answer") from None

    # -------------------------------------------------------------------------- what is sent to it
    def stand_down(self) -> asyncio.Future[None]:
        """Zero from now on, and the end of any arming; then power off. The future is shared: a
        caller that waits for it shields it."""
        self.stops += 1
        self._standing_down = self._thread.request_mode(self._index, Mode.STAND_DOWN)
        self._thread.allow_arming(self._index, 0)
        if self._powering_off is None:
            self._powering_off = asyncio.get_running_loop().create_future()
            self._notifier.poke()
        return self._powering_off

    def _check_arming(self, began: int, mode: Mode) -> None:
        if self.stops != began or self.mode is not mode:
            raise HalError(f"{self}: stopped while it was being armed")

    async def enable(self, began: int) -> None:
        """The first half of arming: zero in its set-point registers, its set-up still there, the
        profile's own steps, until it reports that it is enabled. `began`: its stops when the arming
        began. Raises HalError."""

        def check() -> None:
            self._check_arming(began, Mode.READY)
            limit_ns = round(2 * self._jobs.request_limit_s * NS_PER_S)
            self._thread.allow_arming(self._index, now_ns() + limit_ns)

        await self._jobs.run("arm", self._arming_steps(), check=check)
        check()

    async def go(self, began: int) -> None:
        """The second half of arming: from now on it gets the core's set-points. Raises HalError."""
        self._check_arming(began, Mode.READY)
        await self._obeyed(self._thread.request_mode(self._index, Mode.ARMED))
        if self.mode is not Mode.ARMED:
            reasons = FaultReason(0) if self._report is None else self._report.fault_reasons
            why = "it was stopped, or the set-points are old"
            if FaultReason.POSITION_UNKNOWN in reasons:
                why = "its position is unknown, too old, or out of its range"
            raise HalError(f"{self}: not armed: {why}")
        self._check_arming(began, Mode.ARMED)

    async def write_register(self, register: str, steps: Sequence[Step]) -> float:
        """Steps that write it and read it back; what is in force then. Raises HalError."""
        await self._jobs.run("write", steps)
        return self.profile.registers[register].to_si(steps[0].value or 0)

    async def clear_faults(self) -> None:
        """Power off, then the profile's steps. Raises DriveFault if a fault stays."""
        await asyncio.shield(self.stand_down())
        await self._jobs.run("clear", clear_steps(self._jobs.profile))


class SerialDrive(RtDrive):
    """A drive on a serial line."""

    def __init__(
        self,
        index: int,
        jobs: DriveJobs,
        watchdog_s: float,
        thread: LineThread,
        notifier: Notifier,
        say: Say,
        hint: Callable[[], str],
    ) -> None:
        super().__init__(index, jobs, watchdog_s, thread, notifier, say)
        self.jobs = jobs
        self._line_hint = hint

    def _hint(self) -> str:
        return self._line_hint()

    async def _present(self) -> None:
        """Only an answer shows that it responds."""

    def _why_unresponsive(self, report: DriveReport) -> str:
        return _last_failure(report, servo=self.profile.protocol == "dynamixel")

    def _arming_steps(self) -> tuple[Step, ...]:
        profile = self.jobs.profile
        enabled_place = profile.enabled
        enabled: tuple[Step, ...] = ()
        if enabled_place is not None:
            enabled = (
                Step(
                    register=enabled_place.register,
                    mask=enabled_place.mask,
                    equals=enabled_place.equals,
                    within_s=VERIFY_WITHIN_S,
                ),
            )
        return (*self.jobs.frames.zero_steps(), *kept_steps(self._setup), *profile.arm, *enabled)


def _last_failure(report: DriveReport, *, servo: bool) -> str:
    match report.last_failure:
        case AnswerKind.REFUSED:
            return exception_text(report.last_exception, servo=servo)
        case AnswerKind.BAD_REPLY:
            return "what came is no answer"
        case AnswerKind.NEVER_SILENT:
            return "the line is never silent: another master, or noise"
        case _:
            return f"nothing within {report.deadline_ns / 1e6:.1f} ms"
