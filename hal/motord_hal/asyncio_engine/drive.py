# SPDX-License-Identifier: Apache-2.0
"""One drive of a line in asyncio: its state, its jobs, and how it is stopped.

A subclass for each kind of line defines the frames on the wire.
"""

from __future__ import annotations

import abc
from collections import deque
from collections.abc import Sequence
from typing import Generic, TypeVar

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import HalError, NoReply, WrongDrive
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.faults import STILL_ENABLED_TEXT, FaultWatch, Say
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.line import PRESENT
from motord_hal.fieldbus.plan import Plan, Reading, Wanted
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec
from motord_hal.fieldbus.set_up import SetUpJob, braking_within_s, set_up
from motord_hal.realtime.drive_state import DriveRules, FaultReason, Mode, Stop
from motord_hal.realtime.exchange import Exchange, is_fresh

_STATES = {
    Mode.OFF: DriveState.UNKNOWN,
    Mode.READY: DriveState.READY,
    Mode.ARMED: DriveState.ARMED,
    Mode.UNRESPONSIVE: DriveState.UNRESPONSIVE,
}

AnyPlan = TypeVar("AnyPlan", bound=Plan, covariant=True)


class AsyncioDrive(abc.ABC, Generic[AnyPlan]):
    """State of one drive. All methods run in the event loop. Only methods that the line's task
    calls send frames."""

    def __init__(
        self,
        plan: AnyPlan,
        exchange: Exchange,
        say: Say,
        spec: LineSpec,
        *,
        setup: tuple[Step, ...],
        watchdog_s: float,
    ) -> None:
        self.plan = plan
        self.jobs: deque[Job] = deque()
        self.names = tuple(joint.name for joint in plan.joints)
        self.tries = max(joint.tries for joint in plan.joints)
        self.faults = {name: FaultWatch(name, plan.profile, say) for name in self.names}
        self.enabled_count = 0
        """Number of times that set-points had become enabled when the drive was armed. The count
        also shows an enable that ended before the line read it."""
        self._exchange = exchange
        self._say = say
        self._setup = setup
        self._watchdog_s = watchdog_s
        self._line = spec.index
        self._setpoint_timeout_s = spec.setpoint_timeout_s
        self._rest_velocity_rad_s = spec.rest_velocity_rad_s
        self._braking_within_s = braking_within_s(spec)
        self._values: dict[str, int] = {}
        """Register → newest raw value."""
        self._rules = DriveRules()
        self._reported_unresponsive = False
        self._may_turn = False
        """Whether the drive has been armed since its last set-up, which left it at rest without
        power."""

    # --------------------------------------------------------------------------------- its own wire
    @abc.abstractmethod
    def opened(self) -> None:
        """Note that the medium is open. The drive's state is unknown."""

    @property
    @abc.abstractmethod
    def has_stopped_itself(self) -> bool:
        """Whether the drive got nothing for so long that its watchdog, if it has one, has expired:
        the whole process paused. A drive that cannot report this would start again with the next
        set-point."""

    @abc.abstractmethod
    def arming(self) -> Job:
        """Return the job that arms the drive: zero in its set-points, then the profile's steps."""

    @abc.abstractmethod
    async def _write_now(self, steps: Sequence[Step]) -> Sequence[Step]:
        """Send all writes at once, ahead of all jobs. Return those that have to be repeated. Raises
        PortError."""

    # ---------------------------------------------------------------------------------- what it is
    @property
    def state(self) -> DriveState:
        return _STATES[self._rules.mode]

    @property
    def is_cycled(self) -> bool:
        """Whether each cycle sends set-points to the drive."""
        return self.state in PRESENT

    @property
    def sent_motion(self) -> bool:
        """Implement `DriveRules.sent_motion`."""
        return self._rules.sent_motion

    @sent_motion.setter
    def sent_motion(self, value: bool) -> None:
        self._rules.sent_motion = value

    def may_move(self, *, fresh: bool, enabled: bool) -> bool:
        """Whether set-points that are not zero may go to the drive."""
        return self._rules.may_move(fresh=fresh, enabled=enabled)

    def has_to_rest(self, wanted: Wanted) -> bool:
        """Whether the drive was sent motion and the newest set-points are zero: the zero then does
        not wait for the next cycle."""
        return self._rules.has_to_rest(wants_motion=self.plan.wants_motion(wanted))

    @property
    def is_stopping(self) -> bool:
        """Whether a quick stop was sent and the wheel has not been seen at rest since."""
        return self._rules.is_stopping

    def lose(self, error: HalError) -> None:
        """Note that the medium is lost. The drive's state is unknown."""
        self._forget(error)
        self._rules.forget()

    def _forget(self, error: HalError) -> None:
        while self.jobs:
            self.jobs.popleft().fail(error)
        self._values = {}

    @property
    def _probes_brake(self) -> bool:
        """Whether the probes of the unresponsive drive brake it."""
        return self._may_turn

    def _forget_enabled(self) -> None:
        """Drop the value of "enabled", which a step may have changed, until the next read."""
        if self.plan.profile.enabled is not None:
            self._values.pop(self.plan.profile.enabled.register, None)

    def _hint(self) -> str:
        """Return other possible reasons for the drive's silence, from its medium."""
        return ""

    def _answers(self) -> None:
        """Set up the drive, which answers. One that its probes brake is braked on, and so is one
        that was not set up here before: its set-up takes its power when it rests."""
        braking, stop = self._probes_brake or not self._rules.epoch, Stop.NOTHING
        if self.state is DriveState.UNRESPONSIVE:
            stop = self._rules.answers(braking=braking)
        self.configure(f"{self} is being configured", stop, braking=braking)

    def _becomes_unresponsive(self, error: HalError) -> bool:
        """Mark the drive as unresponsive. Return whether that is new, and was reported."""
        self._forget(error)
        self._rules.unresponsive()
        if self._reported_unresponsive:
            return False
        self._reported_unresponsive = True
        why = "; ".join(filter(None, (str(error), self._hint())))
        what = "is refused" if isinstance(error, WrongDrive) else "is unresponsive"
        self._say(EventKind.DRIVE_UNRESPONSIVE, self.names, f"{self} {what}: {why}")
        return True

    # ------------------------------------------------------------------------------------- feedback
    def _put_feedback(self, joint: JointSpec, reading: Reading, stamp_ns: int) -> None:
        """Hand the reading to the core, and report new faults."""
        faults = self.faults[joint.name]
        faults.update(reading.fault_word)
        self._exchange.put_feedback(
            joint.index,
            stamp_ns=stamp_ns,
            count=reading.count,
            velocity_rad_s=reading.velocity_rad_s,
            current_a=reading.current_a,
            voltage_v=reading.voltage_v,
            temperature_c=reading.temperature_c,
            epoch=self._rules.epoch,
            enabled=reading.enabled,
            drive_faults=faults.stopping,
        )

    def _judge_power(self, enabled: bool | None) -> None:
        """Check what the drive reports as enabled. Armed but not enabled: it has lost its power.
        Not armed but enabled: a power-off was lost or refused."""
        before = self._rules.fault_reasons
        stop = self._rules.check_power(enabled, self.tries, settled=not self.jobs)
        if stop is Stop.NOTHING:
            return
        if self._rules.mode is Mode.OFF:
            text = f"{self} is not enabled any more: set up again, disarmed"
            self._say(EventKind.DRIVE_WARNING, self.names, text)
            self.configure(text, stop)
            return
        if FaultReason.STILL_ENABLED in self._rules.fault_reasons & ~before:
            text = f"{self} {STILL_ENABLED_TEXT}"
            self._say(EventKind.DRIVE_WARNING, self.names, text)
        self._take_power()

    def _rests_at(self, velocity_rad_s: float) -> bool:
        """Whether a wheel is at rest. NaN is not: then the time limit decides."""
        return abs(velocity_rad_s) < self._rest_velocity_rad_s

    def _end_stopping(self, *, at_rest: bool) -> None:
        """Remove the power if the quick stop has ended."""
        if self._rules.end_stopping(now_ns(), at_rest=at_rest) is not Stop.NOTHING:
            self._take_power()

    def _take_power(self) -> None:
        """Queue a power-off. No caller waits for it."""
        self._submit_power_off()

    # ------------------------------------------------------------------------------------ its jobs
    def submit(self, job: Job) -> Job:
        """Queue a job. An urgent one goes ahead of the others."""
        if job.urgent:
            self.jobs.appendleft(job)
        else:
            self.jobs.append(job)
        return job

    def _submit_power_off(self) -> Job:
        self._drop_quick_stop()
        return self.submit(Job("disarm", self.plan.profile.disarm, urgent=True))

    def configure(self, why: str, stop: Stop = Stop.NOTHING, *, braking: bool = False) -> None:
        """Discard the drive's values, and set it up again. It ends READY, never ARMED. A power-off
        goes first if one is pending, or if the rules demand one: in `stop`, which they returned
        earlier, or now; not (`braking`) while the drive brakes."""
        pending = [job for job in self.jobs if job.name == "disarm"]
        for job in pending:
            self.jobs.remove(job)
        demanded = {stop, self._rules.request(Mode.OFF)}
        if Stop.POWER_OFF in demanded and not pending and not braking:
            pending = [Job("disarm", self.plan.profile.disarm, urgent=True)]
        self._forget(NoReply(why))
        self.jobs.extend(pending)
        joints, profile = self.plan.joints, self.plan.profile
        rest_rad_s = self._rest_velocity_rad_s
        parts = set_up(joints, profile, self._setup, rest_rad_s, self._warn, self._braking_within_s)
        self.submit(SetUpJob(parts))

    def _warn(self, text: str) -> None:
        self._say(EventKind.DRIVE_WARNING, self.names, f"{self} {text}")

    def _drop(self, job: Job) -> None:
        if job in self.jobs:
            self.jobs.remove(job)

    def _drop_all(self, name: str, why: str) -> None:
        for job in [job for job in self.jobs if job.name == name]:
            self._drop(job)
            job.fail(HalError(why))

    def _finished(self, job: Job) -> None:
        if job.name == "configure":
            self._configured()
        elif job.name == "arm":
            self._armed()
            if self.state is not DriveState.ARMED:
                job.fail(HalError(f"{self}: stopped while it was being armed"))
                return
        job.finish()

    def _configured(self) -> None:
        self._rules.request(Mode.READY)
        if self._reported_unresponsive:
            self._say(EventKind.DRIVE_BACK, self.names, f"{self} is back, configured and disarmed")
        else:
            self._say(EventKind.DRIVE_READY, self.names, f"{self} is configured and disarmed")
        self._reported_unresponsive = False

    def _armed(self) -> None:
        newest = self._exchange.take_setpoints(self._line)
        good = is_fresh(newest.stamp_ns, self._setpoint_timeout_s)
        self._rules.request(Mode.ARMED, fresh=good, enabled_count=self.enabled_count)

    # ------------------------------------------------------------------------------------ stopping
    async def guard(self, *, fresh: bool, enabled: bool, enabled_count: int) -> None:
        """Check the newest set-points. A stop that they demand goes out ahead of everything else.
        Only the line's task may call this. Raises PortError."""
        stop = self._rules.guard(
            now_ns(),
            fresh=fresh,
            left_alone=self.has_stopped_itself,
            enabled=enabled,
            enabled_count=enabled_count,
        )
        if stop is Stop.QUICK:
            await self.quick_stop()
        elif stop is Stop.POWER_OFF:
            await self.power_off()

    async def take_over(self) -> None:
        """Stop a drive that another program left running, as if it had been armed here. This
        replaces `opened`. Raises PortError."""
        self._may_turn = True
        await self.quick_stop()

    async def quick_stop(self) -> None:
        """Stop now, ahead of everything else. The power goes off when the wheel is at rest. Only
        the line's task may call this. Raises PortError."""
        self._disarmed()
        self._rules.quick_stop(now_ns())
        await self._send_now("quick_stop", self.plan.profile.quick_stop)

    async def power_off(self) -> None:
        """Remove the power now, ahead of all else. Only the line's task may call this. Raises
        PortError."""
        self._powerless()
        await self._send_now("disarm", self.plan.profile.disarm)

    async def send_power_off(self) -> bool:
        """Send the power-off once. Return False if some of it is not confirmed."""
        self._powerless()
        return not await self._write_now(self.plan.profile.disarm)

    @property
    def may_report(self) -> bool:
        """Whether the drive was sent its last power-off and still answers, so that it can report
        that it has no power."""
        return False

    async def _send_now(self, name: str, steps: Sequence[Step]) -> None:
        """Send the steps. Failed ones become a job, except on an unresponsive drive: it is
        probed."""
        left = await self._write_now(steps)
        if left and self.state is not DriveState.UNRESPONSIVE:
            self.submit(Job(name, left, urgent=True))

    def _powerless(self) -> None:
        """Note that the drive's power is switched off, whether it was stopping or not."""
        self._disarmed()
        self._drop_quick_stop()
        self._rules.power_off()

    def stand_down(self) -> Job:
        """Set all set-points to zero from now on, and queue the power-off. Any task may call
        this."""
        self._disarmed()
        return self._submit_power_off()

    def _disarmed(self) -> None:
        """Make every set-point of this drive zero from now on."""
        self._rules.request(Mode.STAND_DOWN)
        self._drop_all("arm", f"{self}: stopped while it was being armed")

    def _drop_quick_stop(self) -> None:
        """Drop a pending quick stop. After the power-off, one that commands zero speed would switch
        the power on again."""
        self._drop_all("quick_stop", f"{self}: its power is switched off")
