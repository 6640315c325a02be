# SPDX-License-Identifier: Apache-2.0
"""The part in asyncio of one drive on a line in C: set-up, arming, disarming and watching.

The cycle and the stops are in C (api_line.h). Here are only requests, which C carries out if that
is safe, and sequences of requests.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any, Protocol

from motord_hal.base.clock import NS_PER_S, now_ns, within
from motord_hal.base.errors import HalError, PortError, Refused, WrongDrive
from motord_hal.base.retry import Backoff
from motord_hal.drives.profile import DriveProfile, Step
from motord_hal.fieldbus.faults import STILL_ENABLED_TEXT, FaultWatch, Say
from motord_hal.fieldbus.job import VERIFY_WITHIN_S, clear_steps, configure_steps, kept_steps
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec
from motord_hal.fieldbus.set_up import Part, braking_within_s, set_up
from motord_hal.realtime.drive_state import FaultReason, Mode
from motord_hal.realtime.line import AnswerKind, DriveReport, LineThread
from motord_hal.realtime.thread import AnyDriveReport, LineThreadHandle
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.jobs import DriveJobs
from motord_hal.rt_engine.rs485.request_queue import Check, exception_text

RETRY_FIRST_S = 0.1
RETRY_LIMIT_S = 2.0
OBEYED_WITHIN_S = 1.0
"""Deadline for a mode request. C carries it out or refuses it within milliseconds, but asyncio may
be late to see that."""

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
    """Runs sequences of steps with one drive, beside its cycle."""

    profile: DriveProfile
    joints: tuple[JointSpec, ...]
    unit: int

    @property
    def request_limit_s(self) -> float:
        """Longest time until a request is sent or dropped."""
        ...

    async def run(
        self, name: str, steps: Sequence[Step], *, urgent: bool = ..., check: Check = ...
    ) -> int: ...


class RtDrive(abc.ABC):
    """Drive number `index` of the line's table."""

    def __init__(
        self,
        index: int,
        jobs: Jobs,
        spec: LineSpec,
        thread: LineThreadHandle,
        notifier: Notifier,
        say: Say,
    ) -> None:
        self._jobs = jobs
        self.names = tuple(joint.name for joint in jobs.joints)
        self.faults = {name: FaultWatch(name, jobs.profile, say) for name in self.names}
        self._index = index
        self._setup = configure_steps(jobs.profile, spec.watchdog_s)
        self._rest_velocity_rad_s = spec.rest_velocity_rad_s
        self._braking_within_s = braking_within_s(spec)
        self._thread = thread
        self._notifier = notifier
        self._say = say
        self._report: AnyDriveReport | None = None
        self._backoff = Backoff(RETRY_FIRST_S, RETRY_LIMIT_S)
        self._failed_setup = False
        self._reported_unresponsive = False
        self.stops = 0
        """How often the drive was stood down. A change during an arming ends the arming."""
        self._standing_down = 0
        """Count of the newest request STAND_DOWN."""
        self._powering_off: asyncio.Future[None] | None = None

    def __str__(self) -> str:
        return f"{', '.join(self.names)} (unit {self._jobs.unit})"

    @abc.abstractmethod
    def _why_unresponsive(self, report: Any) -> str:
        """Return the reason, by the report, why the drive is unresponsive."""

    @abc.abstractmethod
    def _arming_steps(self) -> tuple[Step, ...]:
        """Return the steps of arming: zero set-points, then the profile's steps, until the drive
        reports that it is enabled."""

    def _hint(self) -> str:
        """Return another possible reason why the drive is unresponsive, which its medium shows;
        empty: no other reason is known."""
        return ""

    @abc.abstractmethod
    async def _present(self) -> None:
        """Wait until the drive responds, if its medium shows that before the set-up."""

    # -------------------------------------------------------------------------------------- state
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
        """Whether a quick stop was sent, and no report has shown the wheel at rest since."""
        return self._report is not None and self._report.stopping

    def lose(self, error: HalError) -> None:
        """Forget the drive's state, because the line is lost; callers that wait get `error`."""
        self._report = None
        self._failed_setup = False
        self.stops += 1
        self._powered_off(error)

    def update(self, report: AnyDriveReport, fault_words: Sequence[int]) -> None:
        """Store the newest report of C; report changes as events."""
        before = self.mode
        before_reasons = FaultReason(0) if self._report is None else self._report.fault_reasons
        self._report = report
        if report.cycles:  # before the first cycle no fault word has been read
            for joint in self._jobs.joints:
                self.faults[joint.name].update(fault_words[joint.index])
        # modes between two reports are not seen: the drive may have been unresponsive meanwhile
        if report.mode is Mode.READY and before not in (Mode.READY, Mode.ARMED):
            self._is_ready()
        elif report.mode in (Mode.UNRESPONSIVE, Mode.BACK):
            self._is_unresponsive(self._why_unresponsive(report))
        for bit in report.fault_reasons & ~before_reasons:
            if bit in _WARNINGS:
                self._warn(_WARNINGS[bit])

    def _is_ready(self) -> None:
        self._backoff.reset()
        if self._reported_unresponsive:
            self._say(EventKind.DRIVE_BACK, self.names, f"{self} is back, configured and disarmed")
        else:
            self._say(EventKind.DRIVE_READY, self.names, f"{self} is configured and disarmed")
        self._reported_unresponsive = False

    def _is_unresponsive(self, why: str, what: str = "is unresponsive") -> None:
        if not self._reported_unresponsive:
            self._reported_unresponsive = True
            cause = "; ".join(filter(None, (why, self._hint())))
            self._say(EventKind.DRIVE_UNRESPONSIVE, self.names, f"{self} {what}: {cause}")

    # -------------------------------------------------------------------------------- the two tasks
    async def keep_set_up(self) -> None:
        """Set the drive up and request READY whenever C reports that it is not set up, for ever."""
        while True:
            await self._notifier.until(lambda: self.mode in (Mode.OFF, Mode.BACK))
            try:
                await self._present()
                self._failed_setup = False
                await self._set_up_now()
                await self._obeyed(self._thread.request_mode(self._index, Mode.READY))
                continue
            except PortError:
                pass  # the line has also seen it, and ends this task
            except WrongDrive as error:
                self._failed_setup = True
                self._is_unresponsive(str(error), what="is refused")
            except HalError as error:
                self._failed_setup = True
                self._is_unresponsive(str(error))
            await asyncio.sleep(self._backoff.next_s())

    async def _set_up_now(self) -> None:
        parts = set_up(
            self._jobs.joints, self.profile, self._setup, self._rest_velocity_rad_s, self._warn,
            self._braking_within_s,
        )  # fmt: skip
        part = next(parts)
        with contextlib.suppress(StopIteration):
            while True:
                part = parts.send(await self._do(part))

    async def _do(self, part: Part) -> int:
        if not part.stops:
            return await self._jobs.run("configure", part.steps)
        with contextlib.suppress(Refused):  # the others were sent
            await self._jobs.run("configure", part.steps, urgent=True)
        return 0

    def _warn(self, text: str) -> None:
        self._say(EventKind.DRIVE_WARNING, self.names, f"{self} {text}")

    async def keep_powered_off(self) -> None:
        """Power the drive off whenever it was stood down, before all other requests, for ever."""
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
        """Wait until C has carried out or refused the mode request with this count. Raise HalError
        if the thread does not answer in time."""
        try:
            async with within(OBEYED_WITHIN_S):
                await self._notifier.until(
                    lambda: self._report is not None and self._report.request_seen >= request
                )
        except TimeoutError:
            raise HalError(f"{self}: the line's thread does not answer") from None

    # ------------------------------------------------------------------------------------ requests
    def stand_down(self) -> asyncio.Future[None]:
        """Make all set-points zero from now on, end any arming, and start a power-off. Return the
        future of the power-off. Several callers share it: shield it when you wait for it."""
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
        """Do the first half of arming: write zero set-points, check the set-up, do the profile's
        steps, wait until the drive reports that it is enabled. `began` is the value of `stops` when
        the arming began. Raise HalError on failure, or if the drive was stood down since."""

        def check() -> None:
            self._check_arming(began, Mode.READY)
            limit_ns = round(2 * self._jobs.request_limit_s * NS_PER_S)
            self._thread.allow_arming(self._index, now_ns() + limit_ns)

        await self._jobs.run("arm", self._arming_steps(), check=check)
        check()

    async def go(self, began: int) -> None:
        """Do the second half of arming: from now on the drive gets the core's set-points. `began`
        and errors as in `enable`."""
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
        """Run the steps that write a register and read it back. Return the value in force. Raise
        HalError if a step fails."""
        await self._jobs.run("write", steps)
        return self.profile.registers[register].to_si(steps[0].value or 0)

    async def clear_faults(self) -> None:
        """Power the drive off, then clear its faults. Raise DriveFault if a fault stays."""
        await asyncio.shield(self.stand_down())
        await self._jobs.run("clear", clear_steps(self._jobs.profile))


class SerialDrive(RtDrive):
    """A drive on a serial line."""

    def __init__(
        self,
        index: int,
        jobs: DriveJobs,
        spec: LineSpec,
        thread: LineThread,
        notifier: Notifier,
        say: Say,
        hint: Callable[[], str],
    ) -> None:
        super().__init__(index, jobs, spec, thread, notifier, say)
        self.jobs = jobs
        self._line_hint = hint

    def _hint(self) -> str:
        return self._line_hint()

    async def _present(self) -> None:
        """Do not wait: only an answer in the set-up shows that a serial drive responds."""

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
