# SPDX-License-Identifier: Apache-2.0
"""The CAN line on asyncio: one task sends, for all drives of a bus.

A cycle: every drive gets the newest set-points, is asked for what it does not send by itself, and
goes one step further in its jobs. What drives say is taken in as it comes; nothing is sent then.
"""

from __future__ import annotations

import asyncio
from collections import deque

import can

from motord_hal.can.bus import CanBus
from motord_hal.can.drive import CanDrive
from motord_hal.can.plan import CanPlan, Wanted
from motord_hal.clock import now_ns, now_s, sleep_until_s
from motord_hal.drives.profile import Step
from motord_hal.engine.job import Job, clear_steps
from motord_hal.engine.parameter import readable, write_steps
from motord_hal.engine.units import joints_by_unit
from motord_hal.errors import DriveFault, HalError, NoReply, PortError
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
from motord_hal.rt import Exchange, Setpoints

REOPEN_FIRST_S = 0.1
REOPEN_LIMIT_S = 2.0
SHUTDOWN_WITHIN_S = 0.5
SHUTDOWN_STOPPING_S = 0.35
"""So much of it may pass until the wheels are at rest; then the power goes off all the same."""
LOOK_EVERY_S = 0.02
"""Between cycles: how often it is looked whether the wheels have to stop."""
STOPPING_CYCLE_S = 0.01
JOB_ALLOWANCE_S = 1.0
"""Whoever waits for jobs waits so much longer than they can take on the bus: the event loop may be
late. Nothing moves meanwhile: a drive that is not armed is told zero, or nothing."""
CYCLES_KEPT = 64
STEADY_S = 1.0
"""A bus that has worked for so long is reopened at once when it fails again."""


class CanLine:
    """ports.Line for `kind = "can"`, engine "asyncio"."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        self.spec = spec
        self._exchange = exchange
        self._listener = listener
        plans = [CanPlan(joints) for joints in joints_by_unit(spec)]
        identifiers = [one for plan in plans for one in plan.identifiers]
        self._syncs = tuple(dict.fromkeys(plan.sync for plan in plans if plan.sync))
        self._bus = CanBus(
            spec.port, spec.baudrate, spec.data_baudrate, identifiers, self._take_frame
        )
        self._drives = [
            CanDrive(
                plan,
                self._bus.send,
                exchange,
                cycle_hz=spec.cycle_hz,
                watchdog_s=spec.watchdog_s,
                say=self._say,
            )
            for plan in plans
        ]
        self._by_identifier = {
            one: drive for drive in self._drives for one in drive.plan.identifiers
        }
        self._open = False
        self._said_lost = False
        self._backoff = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S)
        self._reopened = 0
        self._frames = 0
        self._cycles = 0
        self._cycle_starts_s: deque[float] = deque(maxlen=CYCLES_KEPT)

    # ------------------------------------------------------------------------------------ what is
    @property
    def engine(self) -> str:
        return "asyncio"

    @property
    def state(self) -> LineState:
        if not self._open:
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
        """As ports.Line.stats; `exchanges` counts frames of the drives. There are no round trips:
        most of what comes was not asked for."""
        wire = (self.spec.baudrate, self.spec.data_baudrate)
        free = 1.0 - sum(drive.plan.own_load(*wire) for drive in self._drives)
        starts = self._cycle_starts_s
        span_s = starts[-1] - starts[0] if len(starts) > 1 else 0.0
        return LineStats(
            exchanges=self._frames,
            cycles=self._cycles,
            reopened=self._reopened,
            errors=dict(self._bus.errors),
            cycle_hz=(len(starts) - 1) / span_s if span_s > 0 else 0.0,
            wire_limit_hz=max(free, 0.0) / sum(d.plan.cycle_time_s(*wire) for d in self._drives),
        )

    def _say(self, kind: EventKind, joints: tuple[str, ...], text: str) -> None:
        self._listener(LineEvent(kind, self.spec.name, joints, text))

    def _take_frame(self, message: can.Message, stamp_ns: int) -> None:
        drive = self._by_identifier.get((message.arbitration_id, message.is_extended_id))
        if drive is None:
            return
        found = drive.plan.parse(
            message.arbitration_id, bytes(message.data), extended=message.is_extended_id
        )
        if found is None:
            self._bus.errors["bad_frame"] += 1
            return
        self._frames += 1
        drive.receive(*found, stamp_ns)

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """As ports.Line.run."""
        try:
            while True:
                await self._open_bus()
                try:
                    await self._go_round()
                except PortError as error:
                    self._lose_bus(error)
        finally:
            try:
                await self._shut_down()
            finally:
                self._close(PortError(f"{self.spec.name} is closed"))

    async def _open_bus(self) -> None:
        if self._said_lost:
            await asyncio.sleep(self._backoff.next_s())
        while True:
            try:
                await self._bus.open()
                break
            except PortError as error:
                self._lose_bus(error)
            await asyncio.sleep(self._backoff.next_s())
        self._reopened += self._said_lost
        self._open, self._said_lost = True, False
        joints = tuple(joint.name for joint in self.spec.joints)
        self._say(EventKind.LINE_OPEN, joints, f"{self.spec.name} is open on {self.spec.port}")
        for drive in self._drives:
            drive.opened()

    def _lose_bus(self, error: PortError) -> None:
        self._close(error)
        if not self._said_lost:
            self._said_lost = True
            joints = tuple(joint.name for joint in self.spec.joints)
            self._say(EventKind.LINE_LOST, joints, f"{self.spec.name}: {error}")

    def _close(self, error: PortError) -> None:
        self._open = False
        self._bus.close()
        for drive in self._drives:
            drive.lose(error)

    async def _go_round(self) -> None:
        """Cycle for ever at most `cycle_hz`; a late cycle is not caught up. Raises PortError."""
        period_s = 1.0 / self.spec.cycle_hz
        opened_s = due_s = now_s()
        while True:
            self._bus.catch_up()  # before anyone is found missing
            self._bus.check()
            self._cycles += 1
            self._cycle_starts_s.append(now_s())
            self._obey_setpoints()
            for drive in self._drives:
                drive.cycle(self._wanted(drive))
            self._synchronise()
            if now_s() > opened_s + STEADY_S:
                self._backoff.reset()
            due_s = max(due_s + period_s, now_s())
            await self._wait_for_cycle(due_s)
            due_s = min(due_s, now_s())

    def _synchronise(self) -> None:
        """The drives do now, all at once, what they were told in this cycle. Raises PortError."""
        for sync in self._syncs:
            self._bus.send(sync)
        for drive in self._drives:
            drive.synchronised()

    async def _wait_for_cycle(self, due_s: float) -> None:
        """A stop does not wait for the next cycle of a slow line. Always gives the event loop a
        turn: frames come in meanwhile."""
        await asyncio.sleep(0)
        while now_s() < due_s and not any(self._has_to_stop(drive) for drive in self._drives):
            await sleep_until_s(min(due_s, now_s() + LOOK_EVERY_S))
            self._bus.check()

    def _has_to_stop(self, drive: CanDrive) -> bool:
        heard = drive.state in (DriveState.READY, DriveState.ARMED)
        wishes = self._wanted(drive).values()
        return heard and drive.told_motion and not any(any(wish) for wish in wishes)

    # ------------------------------------------------------------------------------------- safety
    def _wanted(self, drive: CanDrive) -> Wanted:
        """The newest set-points, or nothing at all: the drive is then told zero."""
        newest = self._exchange.take_setpoints(self.spec.index)
        if drive.state is not DriveState.ARMED or not newest.enabled or not _fresh(newest):
            return {}
        return {
            joint.index: (
                newest.joints[joint.index].velocity_rad_s,
                newest.joints[joint.index].duty,
            )
            for joint in drive.plan.joints
            if joint.index < len(newest.joints)
        }

    def _obey_setpoints(self) -> None:
        """Old set-points: quick stop. Not enabled any more: power off. Both before all else."""
        newest = self._exchange.take_setpoints(self.spec.index)
        fresh = _fresh(newest)
        for drive in self._drives:
            if drive.state is not DriveState.ARMED:
                continue
            if not fresh or drive.has_stopped_itself:
                drive.quick_stop()
            elif newest.enabled:
                drive.was_enabled = True
            elif drive.was_enabled:
                drive.power_off()

    async def _shut_down(self) -> None:
        """Quick stop, then power off, on every drive; within SHUTDOWN_WITHIN_S."""
        if not self._open:
            return
        stopping_by_s = now_s() + SHUTDOWN_STOPPING_S
        try:
            async with asyncio.timeout(SHUTDOWN_WITHIN_S):
                stopping = [drive for drive in self._drives if drive.state is DriveState.ARMED]
                for drive in stopping:
                    drive.quick_stop()
                while stopping and now_s() < stopping_by_s:
                    for drive in stopping:
                        drive.cycle({})
                    self._synchronise()
                    await asyncio.sleep(STOPPING_CYCLE_S)
                    stopping = [drive for drive in stopping if drive.is_stopping]
                for drive in self._drives:
                    drive.power_off()
        except (TimeoutError, PortError) as error:
            text = f"{self.spec.name}: not every drive was switched off at the end: {error}"
            self._say(EventKind.DRIVE_WARNING, tuple(j.name for j in self.spec.joints), text)

    # ------------------------------------------------------------------------------ what is asked
    async def arm(self) -> None:
        """As ports.Line.arm."""
        self._check_ready_to_arm()
        jobs = [
            drive.submit(drive.arming())
            for drive in self._drives
            if drive.state is not DriveState.ARMED
        ]
        armed = False
        try:
            await self._finish(jobs, "arm")
            armed = True
        finally:
            if not armed:
                for drive in self._drives:
                    drive.stand_down()

    def _check_ready_to_arm(self) -> None:
        self._check_open()
        for drive in self._drives:
            if drive.state in (DriveState.QUIET, DriveState.UNKNOWN):
                raise NoReply(f"{drive} is {drive.state.value}: it cannot be armed")
            for name, watch in drive.faults.items():
                if watch.stopping:
                    raise DriveFault(f"{name} reports {', '.join(watch.words)}")
        if not _fresh(self._exchange.take_setpoints(self.spec.index)):
            raise HalError(f"{self.spec.name}: no fresh set-points: is the loop running?")

    async def disarm(self) -> None:
        """As ports.Line.disarm. From the call on, every set-point is zero."""
        self._check_open()
        present = [drive for drive in self._drives if drive.state is not DriveState.QUIET]
        await self._finish([drive.stand_down() for drive in present], "disarm")

    async def clear_faults(self) -> None:
        """As ports.Line.clear_faults. Drives without a fault are left as they are."""
        self._check_open()
        jobs = []
        for drive in self._drives:
            if any(watch.word for watch in drive.faults.values()) and drive.state in (
                DriveState.READY,
                DriveState.ARMED,
            ):
                drive.stand_down()
                jobs.append(drive.submit(Job("clear", clear_steps(drive.plan.profile))))
        await self._finish(jobs, "clear")

    async def read_register(self, joint: str, register: str) -> float:
        """As ports.Line.read_register; a register is a signal. One that the drive sends unasked is
        the next one that comes."""
        drive = self._drive_of(joint)
        found = readable(drive.plan.profile, register)
        frame = drive.plan.read_frame_of(register)
        if not frame.period_s and not frame.ask:
            raise LookupError(f"{register}: the drive neither sends it nor can be asked for it")
        self._check_open()
        job = drive.submit(Job("read", (Step(register=register, mask=0, equals=0),)))
        await self._finish([job], "read")
        return found.to_si(job.raw)

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """As ports.Line.write_register."""
        drive = self._drive_of(joint)
        steps = write_steps(drive.plan.profile, register, value)
        self._check_open()
        job = drive.submit(Job("write", steps))
        await self._finish([job], "write")
        return drive.plan.profile.registers[register].to_si(job.raw)

    def _drive_of(self, joint: str) -> CanDrive:
        for drive in self._drives:
            if joint in drive.names:
                return drive
        raise LookupError(f'{self.spec.name} has no joint "{joint}"')

    def _check_open(self) -> None:
        if not self._open:
            raise PortError(f"{self.spec.name} is not open on {self.spec.port}")

    async def _finish(self, jobs: list[Job], what: str) -> None:
        """Wait for all; raise the first HalError, or NoReply when it takes too long."""
        tries = max(drive.tries for drive in self._drives)
        longest_s = max((job.limit_s(1.0 / self.spec.cycle_hz, tries) for job in jobs), default=0.0)
        limit_s = JOB_ALLOWANCE_S + 2.0 * longest_s  # one may be ahead of it
        try:
            async with asyncio.timeout(limit_s):
                results = await asyncio.gather(*(job.done for job in jobs), return_exceptions=True)
        except TimeoutError:
            raise NoReply(f"{self.spec.name}: {what} was not done in {limit_s:.1f} s") from None
        for result in results:
            if isinstance(result, BaseException):
                raise result


def _fresh(newest: Setpoints) -> bool:
    return newest.stamp_ns > 0 and now_ns() - newest.stamp_ns <= SETPOINT_TIMEOUT_S * 1e9
