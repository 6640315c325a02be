# SPDX-License-Identifier: Apache-2.0
"""A line whose cycle runs in asyncio: its start, its set-points, its end.

One task sends, for all drives. A subclass for each kind of line defines the wire: how it is opened,
what a cycle sends, and how long a job takes.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
from collections.abc import Sequence
from typing import TypeVar

from motord_hal.asyncio_engine.drive import AsyncioDrive
from motord_hal.asyncio_engine.tally import CycleTally
from motord_hal.base.clock import now_ns, now_s, within
from motord_hal.base.errors import NoReply, PortError
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.job import Job, clear_steps
from motord_hal.fieldbus.line import DriveLine
from motord_hal.fieldbus.parameter import readable, write_steps
from motord_hal.fieldbus.plan import Plan, Wanted
from motord_hal.fieldbus.ports import DriveState, EventKind, LineSpec, Listener
from motord_hal.realtime.drive_state import EarlyShare
from motord_hal.realtime.exchange import Exchange, is_fresh

SHUTDOWN_WITHIN_S = 0.5
SHUTDOWN_STOPPING_S = 0.35
"""Part of SHUTDOWN_WITHIN_S that the wheels have to come to rest before the power goes off
anyway."""
POWER_OFF_WITHIN_S = 2.5
"""Time to send each drive its whole power-off once, even beyond SHUTDOWN_WITHIN_S: a silent drive
may still receive."""
REPORT_WITHIN_S = 0.5
"""Time beyond SHUTDOWN_WITHIN_S for a drive that answers to report that it has no power."""
STOPPING_CYCLE_S = 0.01
LOOK_EVERY_S = 0.02
"""Interval, between cycles, at which the line checks for a stop that does not wake it: the core's
loop has died, or asyncio has disarmed a drive."""
JOB_ALLOWANCE_S = 1.0
"""Time that a caller waits for jobs beyond their longest time on the wire: the event loop may be
late. Nothing moves meanwhile: a drive that is not armed gets zero, or nothing."""

AnyDrive = TypeVar("AnyDrive", bound=AsyncioDrive[Plan])


class AsyncioLine(DriveLine[AnyDrive]):
    """`ports.Line` for the engine "asyncio"."""

    unresponsive_text = "no answer"
    """Why drives may not get their last power-off although the medium is open."""

    def __init__(
        self, spec: LineSpec, exchange: Exchange, listener: Listener, period_s: float
    ) -> None:
        super().__init__(spec, listener)
        self._exchange = exchange
        self._period_s = period_s
        self._cycles = CycleTally()
        self._woken = asyncio.Event()
        self._early = EarlyShare()
        self._handed: dict[AnyDrive, Wanted] = {}
        """Set-points that the newest cycle was to send."""

    @property
    def engine(self) -> str:
        return "asyncio"

    # --------------------------------------------------------------------------------- its own wire
    @abc.abstractmethod
    async def _open_wire(self) -> None:
        """Open the wire, with a deadline. Raises PortError."""

    @abc.abstractmethod
    def _look(self) -> None:
        """Take in what came without a request, before each cycle and at times between two. Raises
        PortError."""

    @abc.abstractmethod
    async def _cycle(self) -> None:
        """Send to all drives, receive from them, and advance their jobs. Raises PortError."""

    @abc.abstractmethod
    async def _cycle_at_rest(self, drives: Sequence[AnyDrive]) -> None:
        """Send zero to these drives, receive, and wait a while. Raises PortError."""

    @abc.abstractmethod
    def _limit_s(self, jobs: Sequence[Job]) -> float:
        """Return the longest time that these jobs, begun now, take on the wire."""

    # ------------------------------------------------------------------------------------ the task
    async def _open_medium(self) -> str:
        await self._open_wire()
        return f"{self.spec.name} is open on {self.spec.port}"

    async def _work(self) -> None:
        """Run cycles for ever, once a period at most. A late cycle is not caught up. Raises
        PortError."""
        for drive in self._drives:
            if self.spec.left_running:
                await drive.take_over()
            else:
                drive.opened()
        due_s = now_s()
        with contextlib.ExitStack() as block:
            try:
                block.enter_context(self._exchange.waking(self.spec.index, self._woken.set))
            except OSError as error:  # the line still stops its drives
                text = f"{self.spec.name} is not woken for new commands: {error.strerror}"
                self._say_all(EventKind.DRIVE_WARNING, text)
            while True:
                self._look()
                self._cycles.begin()
                await self._obey_setpoints()
                await self._cycle()
                if now_s() >= due_s:
                    due_s = max(due_s + self._period_s, now_s())
                await self._wait_for_cycle(due_s)

    async def _wait_for_cycle(self, due_s: float) -> None:
        """Wait until the next cycle is due. On a slow line, new set-points and a stop end the
        wait."""
        await asyncio.sleep(0)  # let the event loop run, even if the next cycle is late
        while now_s() < due_s and not any(self._has_to_stop(drive) for drive in self._drives):
            if self._woken.is_set() and self._begins_early():
                return
            with contextlib.suppress(TimeoutError):
                async with within(min(due_s - now_s(), LOOK_EVERY_S)):
                    await self._woken.wait()
            self._look()

    def _begins_early(self) -> bool:
        """Whether something new is to be sent to a drive that may move."""
        self._woken.clear()
        new = any(
            drive.state is DriveState.ARMED and self._newest(drive) != self._handed.get(drive)
            for drive in self._drives
        )
        return new and self._early.take(self._period_s, now_ns())

    def _has_to_stop(self, drive: AnyDrive) -> bool:
        return drive.has_to_rest(self._newest(drive))

    # ------------------------------------------------------------------------------------- safety
    def _wanted(self, drive: AnyDrive) -> Wanted:
        """Return the set-points to send in this cycle, and remember them."""
        self._handed[drive] = self._newest(drive)
        return self._handed[drive]

    def _newest(self, drive: AnyDrive) -> Wanted:
        """Return the newest set-points; empty if the drive may not move: it then gets zero."""
        newest = self._exchange.take_setpoints(self.spec.index)
        good = is_fresh(newest.stamp_ns, self.spec.setpoint_timeout_s)
        if not drive.may_move(fresh=good, enabled=newest.enabled):
            return {}
        return {
            joint.index: newest.joints[joint.index]
            for joint in drive.plan.joints
            if joint.index < len(newest.joints)
        }

    async def _obey_setpoints(self) -> None:
        """Stop armed drives before all else: a quick stop for old set-points, a power-off for
        disabled."""
        armed = [drive for drive in self._drives if drive.state is DriveState.ARMED]
        if not armed:
            return
        count = self._exchange.enabled_count(self.spec.index)
        newest = self._exchange.take_setpoints(self.spec.index)
        good = is_fresh(newest.stamp_ns, self.spec.setpoint_timeout_s)
        for drive in armed:
            await drive.guard(fresh=good, enabled=newest.enabled, enabled_count=count)

    async def _shut_down(self) -> None:
        """Send a quick stop, then a power-off, to every drive. The power-off goes out however the
        stop ended, even by a bug of this program."""
        # an unresponsive drive may still receive it, but must not keep the others waiting
        left = sorted(self._drives, key=lambda drive: drive.state is DriveState.UNRESPONSIVE)
        end_s = now_s() + SHUTDOWN_WITHIN_S
        try:
            with contextlib.suppress(TimeoutError, PortError):
                async with within(SHUTDOWN_STOPPING_S):
                    await self._come_to_rest(left)
        finally:
            await self._switch_all_off(left, end_s)

    async def _switch_all_off(self, left: list[AnyDrive], end_s: float) -> None:
        """Send each drive its power-off, then again until each has confirmed it or time is up. A
        drive that has confirmed it is removed from `left`."""
        why = self.unresponsive_text
        try:
            async with within(POWER_OFF_WITHIN_S):
                await self._switch_each_off(left)
            with contextlib.suppress(TimeoutError):
                async with within(end_s - now_s()):
                    while left:
                        await self._switch_off_again(left)
            async with within(end_s + REPORT_WITHIN_S - now_s()):
                while any(drive.may_report for drive in left):
                    await self._switch_off_again(left)
        except TimeoutError:
            pass  # the drives that are left are reported
        except PortError as error:
            why = str(error)
        finally:
            self._say_left_on(left, why)

    async def _switch_off_again(self, left: list[AnyDrive]) -> None:
        await asyncio.sleep(STOPPING_CYCLE_S)
        self._look()
        await self._switch_each_off(left)

    async def _switch_each_off(self, left: list[AnyDrive]) -> None:
        """Send one power-off to each drive, even if a bug with one raises. Raises PortError."""
        async with contextlib.AsyncExitStack() as each:
            for drive in reversed(left):
                each.push_async_callback(self._try_to_switch_off, drive, left)

    async def _try_to_switch_off(self, drive: AnyDrive, left: list[AnyDrive]) -> None:
        if await drive.send_power_off():
            left.remove(drive)

    async def _come_to_rest(self, drives: Sequence[AnyDrive]) -> None:
        """Send quick stops, and wait until the wheels rest, SHUTDOWN_STOPPING_S at most. Raises
        PortError."""
        rest_by_s = now_s() + SHUTDOWN_STOPPING_S
        for drive in drives:
            if drive.state is DriveState.ARMED:
                await drive.quick_stop()
        while now_s() < rest_by_s and (turning := [one for one in drives if one.is_stopping]):
            await self._cycle_at_rest(turning)

    # ------------------------------------------------------------------------------ requests
    def _setpoints_ns(self) -> int:
        return self._exchange.take_setpoints(self.spec.index).stamp_ns

    async def _arm(self, drives: Sequence[AnyDrive]) -> None:
        for drive in drives:
            drive.enabled_count = self._exchange.enabled_count(self.spec.index)
        await self._finish([drive.submit(drive.arming()) for drive in drives])

    async def _stand_down(self, drives: Sequence[AnyDrive]) -> None:
        await self._finish([drive.stand_down() for drive in drives])

    async def _clear(self, drives: Sequence[AnyDrive]) -> None:
        jobs = []
        for drive in drives:
            drive.stand_down()
            jobs.append(drive.submit(Job("clear", clear_steps(drive.plan.profile))))
        await self._finish(jobs)

    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register`."""
        drive = self._drive_of(joint)
        found = readable(drive.plan.profile, register)
        self._check_open()
        job = drive.submit(Job("read", (Step(register=register, mask=0, equals=0),)))
        await self._finish([job])
        return found.to_si(job.raw)

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """Implement `ports.Line.write_register`."""
        drive = self._drive_of(joint)
        steps = write_steps(drive.plan.profile, register, value)
        self._check_open()
        job = drive.submit(Job("write", steps))
        await self._finish([job])
        return drive.plan.profile.registers[register].to_si(job.raw)

    async def _finish(self, jobs: Sequence[Job]) -> None:
        """Wait for all jobs. Raises the first HalError, or NoReply when they take too long. A
        caller that gives up withdraws its jobs, except urgent ones: power goes off even if no
        caller waits."""
        limit_s = JOB_ALLOWANCE_S + self._limit_s(jobs)
        waits = [asyncio.shield(job.done) if job.urgent else job.done for job in jobs]
        try:
            async with within(limit_s):
                results = await asyncio.gather(*waits, return_exceptions=True)
        except TimeoutError:
            what = f"{self.spec.name}: {jobs[0].name}"
            raise NoReply(f"{what} was not finished in {limit_s:.1f} s") from None
        for result in results:
            if isinstance(result, BaseException):
                raise result
