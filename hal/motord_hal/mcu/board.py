# SPDX-License-Identifier: Apache-2.0
"""One board on a stream line: what it is told in every frame, what it says, whether it is there.

The steps of the profile write registers that every frame carries from then on, and wait for
feedback that was made after the board had heard them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from motord_hal.clock import now_ns, now_s
from motord_hal.drives.profile import Step
from motord_hal.engine.faults import FaultWatch, Say
from motord_hal.engine.job import Job, configure_steps, watchdog_time_s
from motord_hal.errors import DriveFault, HalError, NoReply
from motord_hal.mcu.dialect import Said
from motord_hal.modbus.plan import DrivePlan
from motord_hal.ports import DriveState, EventKind, JointSpec, LineSpec
from motord_hal.rt import Exchange

Wanted = dict[int, tuple[float, float]]
"""Joint index → (wheel rad/s, duty); empty: everything zero."""

STOPPING_WITHIN_S = 1.0
"""After a quick stop the brake stays on until the wheel is at rest, so long at most."""
REST_VELOCITY_RAD_S = 0.1
QUIET_ALLOWANCE_S = 0.12
"""On top of the feedback that may be lost: the event loop, or an adapter, may be late."""
START_GRACE_S = 2.5
"""An Arduino restarts when its port is opened, and its boot loader waits for two seconds."""
WAIT_LEAST_S = 0.25
"""For a step that waits: a frame there and one back, also where the profile gives it no time."""


class Board:
    """State of the board. All its methods run in the line's task or in its reader."""

    def __init__(
        self, spec: LineSpec, exchange: Exchange, say: Say, *, period_s: float, answers: bool
    ) -> None:
        self.plan = DrivePlan(spec.joints, 0.0, lambda _: 0.0)
        self.state = DriveState.UNKNOWN
        self.jobs: deque[Job] = deque()
        self.names = tuple(joint.name for joint in self.plan.joints)
        self.was_enabled = False
        """Set-points were enabled since it was armed: the next disable takes its power."""
        self.faults = {name: FaultWatch(name, self.plan.profile, say) for name in self.names}
        self.watchdog_s = watchdog_time_s(self.plan.profile, spec.watchdog_s)
        tries = max(joint.tries for joint in spec.joints)
        self.quiet_after_s = tries * period_s + QUIET_ALLOWANCE_S
        self._line = spec.name
        self._exchange = exchange
        self._say = say
        self._answers = answers
        self._setup = configure_steps(self.plan.profile, spec.watchdog_s)
        self._kept = tuple(step for step in self._setup if step.value is None)
        self._held: dict[str, int] = {}
        """What the steps have written: it is in every frame."""
        self._values: dict[str, int] = {}
        self._heard_s = 0.0
        self._heard = False
        """Since the port was opened."""
        self._written_ns = 0
        self._stamp_ns = 0
        self._epoch = 0
        self._said_quiet = False
        self._power_off_by_s: float | None = None

    def __str__(self) -> str:
        return f"the board of {', '.join(self.names)}"

    # ------------------------------------------------------------------------------- what it hears
    def setpoints(self, wanted: Wanted) -> dict[str, int]:
        """Register → raw of everything that the next frame carries."""
        armed = self.state is DriveState.ARMED
        return {**self._held, **self.plan.setpoints(wanted if armed else {})}

    def sent(self) -> None:
        """A frame has gone: a board that cannot answer is taken to be there."""
        if not self._answers:
            self._heard, self._heard_s = True, now_s()
            self._stamp_ns = now_ns()
            self._publish()

    # -------------------------------------------------------------------------------- what it says
    def hear(self, said: Said) -> None:
        """A good feedback."""
        self._heard, self._heard_s = True, now_s()
        self._stamp_ns = said.stamp_ns
        self._values = said.values
        if self.state is DriveState.QUIET:
            self.configure(f"{self} is being configured")
        fresh = said.heard_ns >= self._written_ns
        self._check_kept(fresh=fresh)
        if self.jobs:
            self._check_wait(self.jobs[0], fresh=fresh)
        self._publish(fresh=fresh)

    def _check_kept(self, *, fresh: bool) -> None:
        """What its set-up waited for must stay so: a board that was restarted says it here."""
        if self.state not in (DriveState.READY, DriveState.ARMED) or not fresh:
            return
        for step in self._kept:
            if not self._holds(step):
                text = f"{self} was restarted or has lost its set-up ({self._is(step)})"
                self._say(EventKind.DRIVE_WARNING, self.names, f"{text}: set up again, disarmed")
                self.configure(text)
                return

    def _holds(self, step: Step) -> bool:
        return self._values.get(step.register, 0) & step.mask == step.equals

    def _is(self, step: Step) -> str:
        return f"{step.register} is {self._values.get(step.register, 0):#x}"

    def _check_wait(self, job: Job, *, fresh: bool) -> None:
        step = job.step
        if step is None or step.value is not None or not fresh:
            return
        job.raw = self._values.get(step.register, 0)
        if self._holds(step):
            job.advance()

    def _publish(self, *, fresh: bool = True) -> None:
        if self.state not in (DriveState.READY, DriveState.ARMED):
            return
        enabled, moving = None, False
        for joint in self.plan.joints:
            enabled, velocity_rad_s = self._publish_joint(joint)
            moving |= not abs(velocity_rad_s) < REST_VELOCITY_RAD_S
        if self.state is DriveState.ARMED and enabled is False and fresh:
            text = f"{self} is not enabled any more: set up again, disarmed"
            self._say(EventKind.DRIVE_WARNING, self.names, text)
            self.configure(text)
        if self._power_off_by_s is not None and (not moving or now_s() > self._power_off_by_s):
            self.power_off()
        if self.state is DriveState.READY and enabled and fresh and not self.jobs:
            self.power_off()

    def _publish_joint(self, joint: JointSpec) -> tuple[bool | None, float]:
        reading = self.plan.reading(joint, self._values, {})
        faults = self.faults[joint.name]
        faults.update(reading.fault_word)
        self._exchange.put_feedback(
            joint.index,
            stamp_ns=self._stamp_ns,
            count=reading.count,
            velocity_rad_s=reading.velocity_rad_s,
            current_a=reading.current_a,
            voltage_v=reading.voltage_v,
            temperature_c=reading.temperature_c,
            epoch=self._epoch,
            enabled=reading.enabled,
            drive_faults=faults.stopping,
        )
        return reading.enabled, reading.velocity_rad_s

    def value(self, register: str) -> int | None:
        """The newest raw value; None: not heard."""
        return self._values.get(register) if self.state is not DriveState.QUIET else None

    # ------------------------------------------------------------------------------ whether it is
    def begin(self) -> None:
        """The port is open."""
        self._heard, self._heard_s = False, now_s()
        self.configure("the line has just been opened")

    def check_quiet(self) -> None:
        """Once a cycle."""
        silent_s = now_s() - self._heard_s
        limit_s = self.quiet_after_s if self._heard else START_GRACE_S
        if self.state is DriveState.QUIET or silent_s <= limit_s:
            return
        self._go_quiet(NoReply(f"{self._line}: nothing for {silent_s * 1e3:.0f} ms"))

    def _go_quiet(self, error: HalError) -> None:
        self._forget(error)
        self._hold(self.plan.profile.quick_stop)  # it may hear us all the same
        self.state = DriveState.QUIET
        if not self._said_quiet:
            self._said_quiet = True
            self._say(EventKind.DRIVE_QUIET, self.names, f"{self} is quiet: {error}")

    def lose(self, error: HalError) -> None:
        """The port is gone: nothing is known of the board."""
        self._forget(error)
        self._held.clear()
        self.state = DriveState.UNKNOWN

    def _forget(self, error: HalError) -> None:
        while self.jobs:
            self.jobs.popleft().fail(error)
        self._values = {}
        self._power_off_by_s = None

    # ----------------------------------------------------------------------------------- its jobs
    def submit(self, job: Job) -> Job:
        """Queue a job; an urgent one goes ahead of the others."""
        if job.urgent:
            self.jobs.appendleft(job)
        else:
            self.jobs.append(job)
        return job

    def configure(self, why: str) -> None:
        """Set the board up again. It ends READY, never ARMED."""
        self._forget(NoReply(why))
        self._hold(self.plan.profile.disarm)
        self.state = DriveState.UNKNOWN
        self.submit(Job("configure", self._setup))

    def arming(self) -> Job:
        return Job("arm", self.plan.profile.arm)

    def work(self) -> None:
        """Once a cycle, before its frame: the next write, or a look at the clock."""
        while self.jobs and self.jobs[0].done.done():  # whoever wanted it has gone
            self.jobs.popleft()
        if not self.jobs or not self._heard:
            return
        job = self.jobs[0]
        step = job.step
        if step is None:
            self.jobs.popleft()
            self._finished(job)
        elif step.value is not None:
            self._hold((step,))
            job.advance()
        elif job.wait_until_s is None:
            job.wait_until_s = now_s() + max(step.within_s, WAIT_LEAST_S)
        elif now_s() > job.wait_until_s:
            self._waited_in_vain(job, step)

    def _waited_in_vain(self, job: Job, step: Step) -> None:
        wanted = f"not {step.equals or 0:#x}, in {step.within_s:g} s"
        error = DriveFault(f"{self}: {job.name}: {self._is(step)}, {wanted}")
        self.jobs.popleft()
        job.fail(error)
        if job.name == "configure":
            self._go_quiet(error)

    def _hold(self, steps: Sequence[Step]) -> None:
        for step in steps:
            if step.value is not None:
                self._held[step.register] = step.value
                self._written_ns = now_ns()

    def _finished(self, job: Job) -> None:
        if job.name == "configure":
            self._configured()
        elif job.name == "arm":
            self.state, self.was_enabled = DriveState.ARMED, False
        job.finish()

    def _configured(self) -> None:
        self.state = DriveState.READY
        self._epoch += 1
        kind = EventKind.DRIVE_BACK if self._said_quiet else EventKind.DRIVE_READY
        back = "back, " if self._said_quiet else ""
        self._say(kind, self.names, f"{self} is {back}configured and disarmed")
        self._said_quiet = False

    # ------------------------------------------------------------------------------------ stopping
    def quick_stop(self) -> None:
        """From the next frame on: brake; the power goes off when the wheel is at rest."""
        self._disarmed()
        self._power_off_by_s = now_s() + STOPPING_WITHIN_S
        self._hold(self.plan.profile.quick_stop)

    def power_off(self) -> None:
        """From the next frame on: no power."""
        self._disarmed()
        self._power_off_by_s = None
        self._hold(self.plan.profile.disarm)

    def standing_down(self) -> Job:
        """Power off with the next frame; done when the board has said so."""
        self.power_off()
        return self.submit(Job("disarm", self.plan.profile.disarm, urgent=True))

    @property
    def is_stopping(self) -> bool:
        return self._power_off_by_s is not None

    def _disarmed(self) -> None:
        """From now on every set-point is zero."""
        if self.state is DriveState.ARMED:
            self.state = DriveState.READY
        for job in [job for job in self.jobs if job.name == "arm"]:
            self.jobs.remove(job)
            job.fail(HalError(f"{self}: stopped while it was being armed"))
