# SPDX-License-Identifier: Apache-2.0
"""The Modbus RTU line on asyncio: one task owns the port and goes round the drives.

A cycle: every drive in turn gets the newest set-points and is read; then one acyclic slot, for one
exchange of one job (configure, arm, disarm, clear) or one probe of a quiet drive. So a dead drive
costs its neighbours one reply deadline now and then, and a job costs them one exchange a cycle.
"""

from __future__ import annotations

import asyncio
from functools import partial

from motord_hal.clock import now_ns, now_s, sleep_until_s
from motord_hal.drives.profile import Step
from motord_hal.engine.job import Job, clear_steps
from motord_hal.engine.parameter import readable, write_steps
from motord_hal.engine.units import joints_by_unit
from motord_hal.errors import DriveFault, HalError, NoReply, PortError
from motord_hal.modbus.drive import Drive, Wanted
from motord_hal.modbus.guard import GuardedClient
from motord_hal.modbus.link import Link
from motord_hal.modbus.plan import DrivePlan
from motord_hal.modbus.timing import line_gap_s
from motord_hal.ports import (
    SETPOINT_TIMEOUT_S,
    DirectionKind,
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
SLOT_ALLOWANCE_S = 0.1
"""On top of the slowest cycle: lost replies of this drive or of its neighbours."""
JOB_ALLOWANCE_S = 1.0
"""Whoever waits for jobs waits so much longer than they can take on the wire: the event loop may be
late. Nothing moves meanwhile: a drive that is not armed is told zero."""


class ModbusRtuLine:
    """ports.Line for `kind = "modbus-rtu"`, engine "asyncio"."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        self.spec = spec
        self._exchange = exchange
        self._listener = listener
        client = self._new_client(spec)
        self._link = Link(client)
        self._drives = [
            Drive(
                DrivePlan(joints, client.gap_s, client.wire_time_s),
                self._link,
                exchange,
                spec.watchdog_s,
                self._say,
            )
            for joints in joints_by_unit(spec)
        ]
        self._open = False
        self._said_lost = False
        self._backoff = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S)
        self._turn = 0

    def _new_client(self, spec: LineSpec) -> GuardedClient:
        if spec.direction.kind is not DirectionKind.AUTO:
            raise HalError(
                f'{spec.name}: direction = "{spec.direction.kind.value}" is the rt engine\'s: '
                'engine = "rt" or "auto"'
            )
        return GuardedClient(
            spec.port, spec.baudrate, spec.parity, spec.stop_bits, line_gap_s(spec), spec.echo
        )

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
        return self._link.stats(1.0 / sum(d.plan.cycle_time_s() for d in self._drives))

    def _say(self, kind: EventKind, joints: tuple[str, ...], text: str) -> None:
        self._listener(LineEvent(kind, self.spec.name, joints, text))

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """As ports.Line.run."""
        try:
            while True:
                await self._open_port()
                try:
                    await self._go_round()
                except PortError as error:
                    self._lose_port(error)
        finally:
            try:
                await self._shut_down()
            finally:
                self._close(PortError(f"{self.spec.name} is closed"))

    async def _open_port(self) -> None:
        if self._said_lost:
            await asyncio.sleep(self._backoff.next_s())
        while True:
            try:
                await self._link.client.open()
                break
            except PortError as error:
                self._lose_port(error)
            await asyncio.sleep(self._backoff.next_s())
        if self._said_lost:
            self._link.reopened += 1
        self._open, self._said_lost = True, False
        joints = tuple(joint.name for joint in self.spec.joints)
        self._say(EventKind.LINE_OPEN, joints, f"{self.spec.name} is open on {self.spec.port}")
        for drive in self._drives:
            drive.configure("the line has just been opened")

    def _lose_port(self, error: PortError) -> None:
        self._close(error)
        if not self._said_lost:
            self._said_lost = True
            joints = tuple(joint.name for joint in self.spec.joints)
            self._say(EventKind.LINE_LOST, joints, f"{self.spec.name}: {error}")

    def _close(self, error: PortError) -> None:
        self._open = False
        self._link.client.close()
        for drive in self._drives:
            drive.lose(error)

    async def _go_round(self) -> None:
        """Cycle for ever at most `cycle_hz`; a late cycle is not caught up. Raises PortError."""
        period_s = 1.0 / self.spec.cycle_hz
        due_s = now_s()
        while True:
            self._link.count_cycle()
            for drive in self._drives:
                await self._obey_setpoints()
                if drive.state in (DriveState.READY, DriveState.ARMED):
                    await drive.cycle(partial(self._wanted, drive))
            await self._obey_setpoints()
            await self._acyclic_slot()
            self._backoff.reset()
            due_s = max(due_s + period_s, now_s())
            await self._wait_for_cycle(due_s)
            due_s = min(due_s, now_s())

    async def _wait_for_cycle(self, due_s: float) -> None:
        """A stop does not wait for the next cycle of a slow line."""
        while now_s() < due_s and not any(self._has_to_stop(drive) for drive in self._drives):
            await sleep_until_s(min(due_s, now_s() + LOOK_EVERY_S))

    def _has_to_stop(self, drive: Drive) -> bool:
        heard = drive.state in (DriveState.READY, DriveState.ARMED)
        wishes = self._wanted(drive).values()
        return heard and drive.told_motion and not any(any(wish) for wish in wishes)

    # ------------------------------------------------------------------------------------- safety
    def _wanted(self, drive: Drive) -> Wanted:
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

    async def _obey_setpoints(self) -> None:
        """Old set-points: quick stop. Not enabled any more: power off. Both before all else."""
        armed = [drive for drive in self._drives if drive.state is DriveState.ARMED]
        if not armed:
            return
        newest = self._exchange.take_setpoints(self.spec.index)
        fresh = _fresh(newest)
        for drive in armed:
            if not fresh or drive.has_stopped_itself:
                await drive.quick_stop()
            elif newest.enabled:
                drive.was_enabled = True
            elif drive.was_enabled:
                await drive.power_off()

    async def _shut_down(self) -> None:
        """Quick stop, then power off, on every drive; within SHUTDOWN_WITHIN_S."""
        if not self._open:
            return
        # a quiet drive may hear it all the same, but it shall not keep the others waiting
        drives = sorted(self._drives, key=lambda drive: drive.state is DriveState.QUIET)
        stopping_by_s = now_s() + SHUTDOWN_STOPPING_S
        try:
            async with asyncio.timeout(SHUTDOWN_WITHIN_S):
                stopping = [drive for drive in drives if drive.state is DriveState.ARMED]
                for drive in stopping:
                    await drive.quick_stop()
                while stopping and now_s() < stopping_by_s:
                    for drive in stopping:
                        await drive.cycle(dict)
                    stopping = [drive for drive in stopping if drive.is_stopping]
                for drive in drives:
                    await drive.power_off()
        except (TimeoutError, PortError) as error:
            text = f"{self.spec.name}: not every drive was switched off at the end: {error}"
            self._say(EventKind.DRIVE_WARNING, tuple(j.name for j in self.spec.joints), text)

    # ------------------------------------------------------------------------------- acyclic slots
    async def _acyclic_slot(self) -> None:
        """One exchange of one job, or one probe. Urgent jobs first, then fairly in turn."""
        self._turn += 1
        turn = self._turn % len(self._drives)
        order = [*self._drives[turn:], *self._drives[:turn]]
        working = [drive for drive in order if drive.jobs]
        urgent = [drive for drive in working if drive.jobs[0].urgent]
        silent = [
            drive
            for drive in order
            if drive.state is DriveState.QUIET and drive.probe_at_s <= now_s()
        ]
        if urgent:
            await urgent[0].slot()
        elif silent and (not working or self._turn % 2):
            await silent[0].probe()
        elif working:
            await working[0].slot()

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
        """As ports.Line.read_register."""
        drive = self._drive_of(joint)
        found = readable(drive.plan.profile, register)
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

    def _drive_of(self, joint: str) -> Drive:
        for drive in self._drives:
            if joint in drive.names:
                return drive
        raise LookupError(f'{self.spec.name} has no joint "{joint}"')

    def _check_open(self) -> None:
        if not self._open:
            raise PortError(f"{self.spec.name} is not open on {self.spec.port}")

    async def _finish(self, jobs: list[Job], what: str) -> None:
        """Wait for all; raise the first HalError, or NoReply when it takes too long."""
        cycle_s = sum(drive.plan.slowest_cycle_s() for drive in self._drives)
        slot_s = max(1.0 / self.spec.cycle_hz, cycle_s) + SLOT_ALLOWANCE_S
        tries = max(drive.tries for drive in self._drives)
        limit_s = JOB_ALLOWANCE_S + sum(job.limit_s(slot_s, tries) for job in jobs)
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
