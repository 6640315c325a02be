# SPDX-License-Identifier: Apache-2.0
"""One board on a stream line: what it is told in every frame, what it says, whether it is there.

The steps of the profile write registers that every frame carries from then on, and wait for
feedback that was made after the board had heard them.
"""

from __future__ import annotations

from collections.abc import Sequence

from motord_hal.asyncio_engine.drive import AsyncioDrive
from motord_hal.base.clock import now_ns, now_s
from motord_hal.base.errors import DriveFault, HalError, NoReply
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.faults import Say
from motord_hal.fieldbus.job import Job, configure_steps, watchdog_time_s
from motord_hal.fieldbus.line import PRESENT
from motord_hal.fieldbus.plan import Wanted
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec
from motord_hal.mcu.dialect import Said
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.exchange import Exchange

QUIET_ALLOWANCE_S = 0.12
"""On top of the feedback that may be lost: the event loop, or an adapter, may be late."""
START_GRACE_S = 2.5
"""An Arduino restarts when its port is opened, and its boot loader waits for two seconds."""
WAIT_LEAST_S = 0.25
"""For a step that waits: a frame there and one back, also where the profile gives it no time."""


class Board(AsyncioDrive[DrivePlan]):
    """The board. Its reader, too, calls it."""

    def __init__(
        self, spec: LineSpec, exchange: Exchange, say: Say, *, period_s: float, answers: bool
    ) -> None:
        plan = DrivePlan(spec.joints, 0.0, lambda _: 0.0)
        super().__init__(
            plan,
            exchange,
            say,
            setup=configure_steps(plan.profile, spec.watchdog_s),
            watchdog_s=watchdog_time_s(plan.profile, spec.watchdog_s),
            rest_velocity_rad_s=spec.rest_velocity_rad_s,
        )
        self.quiet_after_s = self.tries * period_s + QUIET_ALLOWANCE_S
        self._line = spec.name
        self._answers = answers
        self._kept = tuple(step for step in self._setup if step.value is None)
        self._held: dict[str, int] = {}
        """What the steps have written: it is in every frame."""
        self._heard_s = 0.0
        self._heard = False
        """Since the port was opened."""
        self._written_ns = 0
        self._stamp_ns = 0
        self._sent_s = 0.0

    def __str__(self) -> str:
        return f"the board of {', '.join(self.names)}"

    # ------------------------------------------------------------------------------- what it hears
    def setpoints(self, wanted: Wanted) -> dict[str, int]:
        """Register → raw of everything that the next frame carries."""
        armed = self.state is DriveState.ARMED
        return {**self._held, **self.plan.setpoints(wanted if armed else {})}

    def sent(self, *, motion: bool) -> None:
        """A frame has gone: a board that cannot answer is taken to be there."""
        self._sent_s, self.told_motion = now_s(), motion
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
        if self.state not in PRESENT or not fresh:
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
        if self.state not in PRESENT:
            return
        enabled, moving = None, False
        for joint in self.plan.joints:
            enabled, velocity_rad_s = self._publish_joint(joint)
            moving |= not self._rests_at(velocity_rad_s)
        self._end_stopping(at_rest=not moving)
        if fresh:
            self._judge_power(enabled)

    def _publish_joint(self, joint: JointSpec) -> tuple[bool | None, float]:
        reading = self.plan.reading(joint, self._values, {})
        self._put_feedback(joint, reading, self._stamp_ns)
        return reading.enabled, reading.velocity_rad_s

    def value(self, register: str) -> int | None:
        """The newest raw value; None: not heard."""
        return self._values.get(register) if self.state is not DriveState.QUIET else None

    # ------------------------------------------------------------------------------ whether it is
    @property
    def is_cycled(self) -> bool:
        """Always: also one that is not heard is told to stop."""
        return True

    def opened(self) -> None:
        """As AsyncioDrive.opened."""
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
        self._becomes_quiet(error)
        self._hold(self.plan.profile.quick_stop)  # it may hear us all the same

    def lose(self, error: HalError) -> None:
        """As AsyncioDrive.lose."""
        super().lose(error)
        self._held.clear()

    # ----------------------------------------------------------------------------------- its jobs
    def configure(self, why: str) -> None:
        """As AsyncioDrive.configure."""
        super().configure(why)
        self._hold(self.plan.profile.disarm)

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

    # ------------------------------------------------------------------------------------ stopping
    async def _write_now(self, steps: Sequence[Step]) -> Sequence[Step]:
        """As AsyncioDrive._write_now: the next frame carries them, and every one after it."""
        self._hold(steps)
        return ()

    def _take_power(self) -> None:
        """From the next frame on."""
        self._powerless()
        self._hold(self.plan.profile.disarm)

    def stand_down(self) -> Job:
        """Power off with the next frame; done when the board has said so."""
        self._take_power()
        return super().stand_down()

    @property
    def has_stopped_itself(self) -> bool:
        """As AsyncioDrive.has_stopped_itself."""
        return now_s() - self._sent_s > self._watchdog_s
