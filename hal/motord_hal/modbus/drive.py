# SPDX-License-Identifier: Apache-2.0
"""One Modbus drive: what it gets in each cycle, what it reports, whether it still responds."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence

from motord_hal.asyncio_engine.drive import AsyncioDrive
from motord_hal.base.clock import now_s
from motord_hal.base.errors import BadReply, DriveFault, HalError, NoReply, Refused
from motord_hal.base.retry import Backoff
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.faults import Say
from motord_hal.fieldbus.job import Job, configure_steps, kept_steps, watchdog_time_s
from motord_hal.fieldbus.plan import Wanted
from motord_hal.fieldbus.ports import DriveState, EventKind, LineSpec
from motord_hal.modbus.codec import Request
from motord_hal.modbus.guard import Answer
from motord_hal.modbus.link import Link
from motord_hal.modbus.plan import EXTRA_EVERY_CYCLES, CyclicExchange, DrivePlan, ReadRange
from motord_hal.realtime.drive_state import left_alone
from motord_hal.realtime.exchange import Exchange

PROBE_FIRST_S = 0.1
PROBE_LIMIT_S = 2.0


class Drive(AsyncioDrive[DrivePlan]):
    """One unit on the line. All methods that wait run in the line's one task."""

    def __init__(
        self, plan: DrivePlan, link: Link, exchange: Exchange, spec: LineSpec, say: Say
    ) -> None:
        super().__init__(
            plan,
            exchange,
            say,
            spec,
            setup=configure_steps(plan.profile, spec.watchdog_s),
            watchdog_s=watchdog_time_s(plan.profile, spec.watchdog_s),
        )
        self.probe_at_s = 0.0
        self._link = link
        self._kept = kept_steps(self._setup)
        self._backoff = Backoff(PROBE_FIRST_S, PROBE_LIMIT_S)
        self._stamps_ns: dict[str, int] = {}
        self._stamp_ns = 0
        self._directions: dict[str, int] = {}
        self._last_directions: dict[str, int] = {}
        self._failures = 0
        self._cycles = 0
        self._probes: deque[Request] = deque()
        self._probes_at_once = 0
        self._usual_s = 0.0
        """About twice the longest recent round trip. Other drives wait no longer for their stop."""
        self._asked_s = 0.0
        """Time at which the drive received the newest request that it has answered."""
        self._left_alone = False
        """Whether the drive's watchdog has expired since it was armed."""
        self._power_off_left: Sequence[Step] = ()
        """Steps of the final power-off that were not answered."""

    def __str__(self) -> str:
        return f"{', '.join(self.names)} (unit {self.plan.unit})"

    # ------------------------------------------------------------------------------------ talking
    async def _ask(
        self,
        request: Request,
        send_by_s: float = math.inf,
        *,
        urgent: bool = False,
        others_wait: bool = False,
    ) -> Answer:
        given = [j.reply_timeout_s for j in self.plan.joints if j.reply_timeout_s is not None]
        turnaround_s = self.plan.profile.turnaround_s
        default_s = self._link.client.reply_deadline_s(request, turnaround_s)
        within_s = max(given, default=default_s)
        if others_wait:
            within_s = min(within_s, max(default_s, self._usual_s))
        answer = await self._link.ask(request, within_s, send_by_s, urgent=urgent)
        self._failures = 0
        self._usual_s = max(2.0 * answer.round_trip_s, 0.9 * self._usual_s)
        self._stamp_ns = answer.stamp_ns
        asked_s = answer.stamp_ns * 1e-9 - 0.5 * answer.round_trip_s
        self._left_alone |= left_alone(self._asked_s, asked_s, self._watchdog_s)
        self._asked_s = asked_s
        return answer

    async def _ask_cyclic(self, one: CyclicExchange, send_by_s: float) -> None:
        answer = await self._ask(one.request, send_by_s)
        if one.reads is not None:
            self._take(one.reads, answer)

    async def _read(self, what: ReadRange) -> None:
        self._take(what, await self._ask(what.request(self.plan.unit)))

    def _take(self, what: ReadRange, answer: Answer) -> None:
        values = what.decode(answer.values)
        self._values.update(values)
        self._stamps_ns.update(dict.fromkeys(values, answer.stamp_ns))

    async def _write(self, raw: Mapping[str, int], *, urgent: bool = False) -> None:
        for request in self.plan.writes(raw):
            await self._ask(request, urgent=urgent)

    # ----------------------------------------------------------------------------- the cyclic part
    async def cycle(self, wanted: Callable[[], Wanted]) -> None:
        """Send set-points and read feedback. Failures are counted, not raised; PortError passes."""
        try:
            await self._exchange_cyclic(wanted())
            self._publish()
            if (extra := self._due_extra()) is not None:
                await self._read(extra)
                self._check_setup()
        except (NoReply, BadReply, Refused) as error:
            self._failed(error)
        else:
            self._cycles += 1

    async def _exchange_cyclic(self, wanted: Wanted) -> None:
        raw = self.plan.setpoints(wanted)
        motion = self.plan.wants_motion(wanted)
        self.sent_motion |= motion
        # motion from before a pause of the process is not sent after the pause
        good_for_s = min(self._watchdog_s, self._setpoint_timeout_s + self.plan.slowest_cycle_s())
        send_by_s = now_s() + good_for_s if motion else math.inf
        armed = self.state is DriveState.ARMED
        directions = self.plan.directions(wanted, raw) if armed else {}
        for register, direction in directions.items():
            # a new magnitude never goes out in the old direction, even if the next frame is lost
            if direction not in (self._directions.get(register), self.plan.rests[register]):
                await self._turn({register: self.plan.rests[register]})
        exchanges = self.plan.cyclic(raw)
        last_write = max(n for n, one in enumerate(exchanges) if one.request.values)
        for number, one in enumerate(exchanges):
            await self._ask_cyclic(one, send_by_s if one.request.values else math.inf)
            if number == last_write:
                self.sent_motion = motion
                if self.state is DriveState.ARMED:  # and it was not disarmed meanwhile
                    await self._turn(directions)

    async def _turn(self, directions: Mapping[str, int]) -> None:
        """Send the directions whose arrival is not confirmed."""
        for register, direction in directions.items():
            if self._directions.pop(register, None) != direction:
                await self._write({register: direction})
            self._directions[register] = direction
            if direction != self.plan.rests[register]:
                self._last_directions[register] = direction

    def _check_setup(self) -> None:
        """Check that the drive has kept its set-up: after a short power failure it answers as
        before, but without its watchdog."""
        for step in self._kept:
            raw = self._values.get(step.register)
            if raw is not None and raw & step.mask != step.equals:
                text = f"{self} has lost its set-up ({step.register} is {raw:#x}): set up again"
                self._say(EventKind.DRIVE_WARNING, self.names, f"{text}, disarmed")
                self.configure(text, self._rules.lost_setup())
                return

    def _due_extra(self) -> ReadRange | None:
        """Return the range to read now that may wait, if any; first the one with the enabled
        state."""
        extra, enabled_place = self.plan.extra, self.plan.profile.enabled
        if enabled_place is not None and enabled_place.register not in self._values:
            telling = (
                r for r in extra if any(x.name == enabled_place.register for x in r.registers)
            )
            return next(telling, None)  # None: the next cycle reads it
        if not extra or self._cycles % EXTRA_EVERY_CYCLES:
            return None
        return extra[self._cycles // EXTRA_EVERY_CYCLES % len(extra)]

    def _publish(self) -> None:
        enabled, moving = None, False
        for joint in self.plan.joints:
            reading = self.plan.reading(joint, self._values, self._last_directions)
            channel = self.plan.channel(joint)
            measured = channel.position or channel.velocity or ""
            self._put_feedback(joint, reading, self._stamps_ns.get(measured, self._stamp_ns))
            enabled = reading.enabled
            moving |= not self._rests_at(reading.velocity_rad_s)
        self._end_stopping(at_rest=not moving)
        self._judge_power(enabled)

    # ---------------------------------------------------------------------------- the acyclic part
    def opened(self) -> None:
        """Implement `AsyncioDrive.opened`."""
        self.configure("the line has just been opened")

    def arming(self) -> Job:
        """Return the job that arms: zero in the set-points, a check of the set-up, the profile's
        steps."""
        return Job("arm", (*self.plan.zero_steps(), *self._kept, *self.plan.profile.arm))

    def _forget(self, error: HalError) -> None:
        super()._forget(error)
        self._stamps_ns.clear()
        self._directions.clear()
        self._failures = 0

    async def slot(self) -> None:
        """Do one exchange of the first job. Failures are counted, not raised; PortError passes."""
        job = self.jobs[0]
        if job.done.done():  # its caller has given up
            self._drop(job)
            return
        try:
            if job.step is not None:
                await self._step(job, job.step)
            if job not in self.jobs:
                return  # withdrawn meanwhile: it must not arm
            if job.step is None:
                self._drop(job)
                self._finished(job)
        except (NoReply, BadReply) as error:
            job.failures += 1
            if job.name == "configure":
                self._failed(error)
            elif job.failures >= self.tries:
                self._job_failed(job, error)
        except Refused as error:
            self._job_refused(job, error)
        except DriveFault as error:
            self._job_failed(job, error)

    def _job_refused(self, job: Job, error: Refused) -> None:
        """Handle a refused step. In a stop, the next write may still work."""
        if not job.urgent:
            self._job_failed(job, error)
            return
        job.refused = job.refused or error
        job.advance()

    def _job_failed(self, job: Job, error: HalError) -> None:
        self._drop(job)
        job.fail(error)
        if job.name == "configure":
            self._mark_unresponsive(error)

    async def _step(self, job: Job, step: Step) -> None:
        if step.value is not None:
            await self._write({step.register: step.value}, urgent=job.urgent)
            if job.name != "write":
                self._forget_enabled()
            self._directions.pop(step.register, None)
            job.advance()
            return
        register = self.plan.profile.registers[step.register]
        await self._read(ReadRange(register.address, register.type.words, (register,)))
        job.raw = raw = self._values[step.register]
        if raw & step.mask == step.equals:
            job.advance()
        elif job.wait_until_s is None:
            job.wait_until_s = now_s() + step.within_s
        elif now_s() > job.wait_until_s:
            raise DriveFault(
                f"{self}: {job.name}: {step.register} is {raw:#x} after {step.within_s:g} s, "
                f"not {step.equals or 0:#x}"
            )

    def _armed(self) -> None:
        super()._armed()
        self._may_turn, self._left_alone = True, False

    def _configured(self) -> None:
        self._cycles = 0
        self._failures = 0
        self._backoff.reset()
        self._may_turn = self.sent_motion = False
        super()._configured()

    # -------------------------------------------------------------------------------- not answering
    def _failed(self, error: HalError) -> None:
        self._failures += 1
        if self._failures >= self.tries:
            self._mark_unresponsive(error)

    def _hint(self) -> str:
        return self._link.client.unresponsive_hint()

    def _mark_unresponsive(self, error: HalError) -> None:
        if self._becomes_unresponsive(error):
            self._probes = deque(self._probe_requests())
            self._probes_at_once = len(self._probes) - 1
        self.probe_at_s = now_s() + self._probe_pause_s()

    def _probe_requests(self) -> Iterable[Request]:
        """Yield the requests that probe a silent drive. It may still receive, and follow its last
        set-point as long as reads feed its watchdog: so a drive that may turn gets a stop."""
        if self._may_turn:
            for step in self.plan.profile.quick_stop:
                if step.value is not None:
                    yield from self.plan.writes({step.register: step.value})
        ranges = (*self.plan.fast, *self.plan.extra)
        if self._may_turn or not ranges:
            yield from self.plan.writes(self.plan.setpoints({}))
        if ranges:
            yield ranges[0].request(self.plan.unit)

    def _probe_pause_s(self) -> float:
        """Return the pause before the next probe: 0 until each request of the stop was sent
        once."""
        self._probes_at_once -= 1
        return 0.0 if self._probes_at_once >= 0 else self._backoff.next_s()

    async def probe(self) -> None:
        """Poll an unresponsive drive once. PortError passes."""
        self.probe_at_s = now_s() + self._probe_pause_s()
        request = self._probes[0]
        self._probes.rotate(-1)
        try:
            await self._ask(request, urgent=bool(request.values))
        except (NoReply, BadReply, Refused):
            return
        self._answers()

    # ----------------------------------------------------------------------------------- stopping
    @property
    def has_stopped_itself(self) -> bool:
        """Implement `AsyncioDrive.has_stopped_itself`."""
        return self._left_alone or left_alone(self._asked_s, now_s(), self._watchdog_s)

    def _disarmed(self) -> None:
        super()._disarmed()
        self._directions.clear()
        self._forget_enabled()

    async def send_power_off(self) -> bool:
        """Implement `AsyncioDrive.send_power_off`. Sends all of it even without answers, because a
        silent drive may still receive. The next call sends only what was not answered."""
        self._powerless()
        steps = self._power_off_left or self.plan.profile.disarm
        self._power_off_left = [step for step in steps if await self._write_step(step) is not None]
        return not self._power_off_left

    async def _write_now(self, steps: Sequence[Step]) -> Sequence[Step]:
        """Implement `AsyncioDrive._write_now`. Returns the steps from the first unanswered one on,
        and the refused ones before it."""
        refused: list[Step] = []
        for number, step in enumerate(steps):
            error = await self._write_step(step)
            if isinstance(error, Refused):
                refused.append(step)
            elif error is not None:
                return (*refused, *steps[number:])
        return refused

    async def _write_step(self, step: Step) -> HalError | None:
        """Write one step. Return the error, if any. A drive that refuses a write responds, and gets
        the other writes: only a missing answer counts as a failure."""
        raw = {} if step.value is None else {step.register: step.value}
        try:
            for request in self.plan.writes(raw):
                await self._ask(request, urgent=True, others_wait=True)
        except (NoReply, BadReply) as error:
            self._failed(error)
            return error
        except Refused as error:
            return error
        return None
