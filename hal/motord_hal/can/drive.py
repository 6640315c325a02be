# SPDX-License-Identifier: Apache-2.0
"""One drive on a CAN bus: what it gets in each cycle, what it reports, whether it still responds.

A sent frame proves nothing: only frames of the drive show that it responds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from motord_hal.asyncio_engine.drive import AsyncioDrive
from motord_hal.base.clock import now_ns, now_s
from motord_hal.base.errors import DriveFault, HalError, NoReply, Refused
from motord_hal.base.retry import Backoff
from motord_hal.can.job_step import StepRunner, merged_writes
from motord_hal.can.plan import FIRST_WORD_S, SLOW_EVERY_CYCLES, CanPlan, Sent, with_cycle
from motord_hal.drives.can_profile import Frame
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.faults import Say
from motord_hal.fieldbus.job import Job, configure_steps
from motord_hal.fieldbus.line import PRESENT
from motord_hal.fieldbus.plan import Wanted
from motord_hal.fieldbus.ports import DriveState, LineSpec
from motord_hal.realtime.drive_state import STOPPING_WITHIN_S, LastPowerOff, left_alone
from motord_hal.realtime.exchange import Exchange

PROBE_FIRST_S = 0.1
PROBE_LIMIT_S = 2.0
HELLO_GOOD_FOR_S = 5.0
"""Time for which an answer to `hello` is valid: enough to set the drive up."""
SAMPLE_PART = 0.5
"""Part of a frame's period. Frames that the CAN bus has held up come in bunches; a measurement that
comes sooner than this after the one before adds nothing and is dropped."""

Send = Callable[[Sent], bool]
"""Function that sends a frame. It returns False if the CAN bus takes nothing now."""


class CanDrive(AsyncioDrive[CanPlan]):
    """One node on a CAN bus."""

    def __init__(
        self,
        plan: CanPlan,
        send: Send,
        exchange: Exchange,
        *,
        spec: LineSpec,
        say: Say,
    ) -> None:
        cycle_s = 1.0 / spec.cycle_hz
        super().__init__(
            plan,
            exchange,
            say,
            spec,
            setup=configure_steps(with_cycle(plan.profile, cycle_s), spec.watchdog_s),
            watchdog_s=spec.watchdog_s,
        )
        self._send = send
        self._cycle_s = cycle_s
        self._backoff = Backoff(PROBE_FIRST_S, PROBE_LIMIT_S)
        self._set_up_backoff = Backoff(PROBE_FIRST_S, PROBE_LIMIT_S)
        self._set_up_at_s = 0.0
        self._held: dict[str, int] = {}
        self._runner = StepRunner(plan, self._write, self._ask)
        self._received_s: dict[str, float] = {}
        self._received_ns: dict[str, int] = {}
        self._unanswered: dict[str, tuple[float, int]] = {}
        """Frame that was requested and has not come since → (time of the first request, number)."""
        self._sent_s = 0.0
        """Time of the newest set-points that were sent."""
        self._waits_since_s = 0.0
        """Time when the line was opened or lost. The drive's state is unknown since then."""
        self._unresponsive_since_s = 0.0
        self._probe_at_s = 0.0
        self._cycles = 0
        self._job_s = 0.0
        """Time when a job last wrote or requested something."""
        self._last_off = LastPowerOff()

    def __str__(self) -> str:
        return f"{', '.join(self.names)} (node {self.plan.node})"

    # ----------------------------------------------------------------------------------- feedback
    def receive(self, frame: Frame, values: dict[str, int], stamp_ns: int) -> None:
        """Take in a frame of this drive. Nothing is sent from here."""
        self._received_s[frame.name] = stamp_ns * 1e-9
        self._unanswered.pop(frame.name, None)
        self._runner.received(frame, values)
        next_ns = self._received_ns.get(frame.name, 0) + SAMPLE_PART * frame.period_s * 1e9
        if frame in self.plan.measuring and stamp_ns < next_ns:
            return
        self._values.update(values)
        self._received_ns[frame.name] = stamp_ns
        if self.state in PRESENT and frame in self.plan.fast:
            self._publish()
            self._check_power(frame)

    def _publish(self) -> None:
        """Hand the feedback to the core, once all its frames have come."""
        if not all(frame.name in self._received_ns for frame in self.plan.fast):
            return
        for joint in self.plan.joints:
            reading = self.plan.reading(joint, self._values)
            if reading is None:
                continue  # not a number: the sample grows old, and the core notices
            channel = self.plan.channel(joint)
            measured = channel.position or channel.velocity
            frame = self.plan.read_frame_of(measured) if measured else self.plan.fast[0]
            self._put_feedback(joint, reading, self._received_ns[frame.name])

    def _check_power(self, frame: Frame) -> None:
        """Compare the reported power state with the expected one."""
        enabled_place = self.plan.profile.enabled
        enabled = self.plan.enabled(self._values)
        if (
            enabled_place is None
            or self.plan.read_frame_of(enabled_place.register) is not frame
            or enabled is None
        ):
            return
        self._judge_power(enabled)

    # ------------------------------------------------------------------------- whether it is there
    def _silence_s(self, frame: Frame) -> float:
        if frame.period_s:
            return frame.silence_s
        asked_s = self.tries * self._cycle_s + self.plan.profile.turnaround_s
        return max(frame.silence_s, asked_s)

    def _missing(self) -> Frame | None:
        """Return a frame that has not come for too long, or None."""
        hello = self.plan.hello
        if hello is not None and self.state in (DriveState.UNKNOWN, DriveState.UNRESPONSIVE):
            received_s = self._received_s.get(hello.name, -math.inf)
            return None if now_s() - received_s < HELLO_GOOD_FOR_S else hello
        return next((frame for frame in self.plan.watched if self._is_missing(frame)), None)

    def _is_missing(self, frame: Frame) -> bool:
        """Whether a frame has not come for too long. One that comes only on request counts as
        missing only after requests: this program may have paused."""
        received_s = self._received_s.get(frame.name, -math.inf)
        if frame.period_s or received_s == -math.inf:
            return now_s() - received_s > self._silence_s(frame)
        since_s, questions = self._unanswered.get(frame.name, (math.inf, 0))
        return questions >= self.tries and now_s() - since_s > self._silence_s(frame)

    def _asked_for(self, *frames: Frame) -> None:
        """Count a request for these frames, even if the CAN bus did not take it: if the bus takes
        no frame, no drive can be received either."""
        for frame in frames:
            since_s, questions = self._unanswered.get(frame.name, (now_s(), 0))
            self._unanswered[frame.name] = (since_s, questions + 1)

    def synchronised(self) -> None:
        """Note that the line has sent its SYNC."""
        self._asked_for(*self.plan.answering.get(self.plan.table.sync, ()))

    def look(self) -> None:
        """Check, once a cycle, whether the drive responds. If not, probe it."""
        missing = self._missing()
        setting_up = any(job.name == "configure" for job in self.jobs)
        if missing is None:
            if self.state in (DriveState.UNKNOWN, DriveState.UNRESPONSIVE) and not setting_up:
                self._set_up_again()
        elif setting_up or self.state in self._past_patience():
            self._mark_unresponsive(missing)
        if self.state in (DriveState.UNKNOWN, DriveState.UNRESPONSIVE):
            self._probe(stops=not any(job.name == "configure" for job in self.jobs))

    def _set_up_again(self) -> None:
        """Set up the drive, which responds again. After each failed set-up, wait longer."""
        if now_s() >= self._set_up_at_s:
            self._set_up_at_s = now_s() + self._set_up_backoff.next_s()
            self._answers()

    def _past_patience(self) -> tuple[DriveState, ...]:
        """Return the states in which a missing frame counts now; after opening, there is extra
        time."""
        longest_s = max(self._silence_s(frame) for frame in self.plan.watched)
        if now_s() > self._waits_since_s + longest_s + FIRST_WORD_S:
            return DriveState.READY, DriveState.ARMED, DriveState.UNKNOWN
        return DriveState.READY, DriveState.ARMED

    def _mark_unresponsive(self, missing: Frame) -> None:
        received_s = self._received_s.get(missing.name)
        since = "" if received_s is None else f" for {now_s() - received_s:.2g} s"
        error = NoReply(f"{self}: no {missing.name} frame{since}")
        self._unresponsive(error)

    def _unresponsive(self, error: HalError) -> None:
        if self.plan.hello is not None:
            self._received_s.pop(self.plan.hello.name, None)
        if self._becomes_unresponsive(error):
            self._unresponsive_since_s = now_s()
            self._backoff.reset()
            self._probe_at_s = 0.0

    @property
    def _probes_brake(self) -> bool:
        """Implement `AsyncioDrive._probes_brake`. Later they take its power."""
        return self._may_turn and now_s() <= self._unresponsive_since_s + STOPPING_WITHIN_S

    def _probe(self, *, stops: bool) -> None:
        """Request the frames that do not come by themselves. A silent drive may still receive and
        follow its last set-point, so a drive that may turn gets a stop, except (not `stops`) while
        its set-up brakes it."""
        if now_s() < self._probe_at_s:
            return
        self._probe_at_s = now_s() + self._backoff.next_s()
        if stops and self._probes_brake:
            self._write_all(self.plan.profile.quick_stop)
            self._send_setpoints({})
        elif stops and self._may_turn:
            self._write_all(self.plan.profile.disarm)
        for frame in (self.plan.hello,) if self.plan.hello else self.plan.probed:
            self._ask(frame)

    # ----------------------------------------------------------------------------- the cyclic part
    def cycle(self, wanted: Wanted) -> None:
        """Send set-points and requests, and do one step of the first job. Raises PortError."""
        self.look()
        if self.is_cycled:
            self.send_setpoints(wanted)
            for frame in self.plan.asked_fast:
                self._ask(frame)
            if self._cycles % SLOW_EVERY_CYCLES == 0:
                self._now_and_then(self._cycles // SLOW_EVERY_CYCLES)
            self._cycles += 1
        if self.is_stopping:
            self._end_stopping(at_rest=self._is_at_rest())
        if self.jobs:
            self._slot()

    def _now_and_then(self, turn: int) -> None:
        """Request one frame that may wait. A drive that cannot report its power state gets its
        power-off again: the first one may have been lost."""
        slow = self.plan.asked_slow
        if slow:
            self._ask(slow[turn % len(slow)])
        silent = self.plan.profile.enabled is None and self.state is DriveState.READY
        if silent and not self.jobs and not self.is_stopping:
            self._write_all(self.plan.profile.disarm)

    def send_setpoints(self, wanted: Wanted) -> None:
        """Send only the set-points."""
        received = self.state is DriveState.ARMED or self.is_stopping
        if received or self.plan.table.idle_setpoints:
            self._send_setpoints(wanted if self.state is DriveState.ARMED else {})

    def _send_setpoints(self, wanted: Wanted) -> None:
        raw = self.plan.setpoints(wanted)
        motion = self.plan.wants_motion(wanted)
        self.sent_motion |= motion
        sent = [self._write(frame, raw) for frame in self.plan.setpoint_frames]
        if all(sent):
            self.sent_motion = motion
            self._sent_s = now_s()

    def _write(self, frame: Frame, raw: Mapping[str, int]) -> bool:
        """Send a frame with these signals and the held ones. Return False if the CAN bus takes
        nothing now."""
        self._held.update({name: raw[name] for name in self.plan.held if name in raw})
        self._asked_for(*self.plan.answering[frame.name])
        return self._send(self.plan.write(frame, {**self._held, **raw}))

    def _ask(self, frame: Frame) -> bool:
        question = self.plan.question(frame)
        if question == self.plan.sync:  # SYNC goes to all drives: the line sends it
            return False
        self._asked_for(frame)
        return question is not None and self._send(question)

    # ---------------------------------------------------------------------------- the acyclic part
    def arming(self) -> Job:
        """Return the job that arms: zero in the set-points, then the profile's steps."""
        zeros = self.plan.setpoints({}).items()
        rest = (Step(register=name, value=raw) for name, raw in zeros)
        return Job("arm", (*rest, *self.plan.profile.arm))

    def _forget(self, error: HalError) -> None:
        super()._forget(error)
        self._received_ns.clear()
        self._held.clear()

    def lose(self, error: HalError) -> None:
        """Implement `AsyncioDrive.lose`."""
        super().lose(error)
        self._received_s.clear()
        self._unanswered.clear()
        self._waits_since_s = now_s()

    def opened(self) -> None:
        """Note that the line is open. A drive that may turn gets a stop, as if it had just fallen
        silent."""
        self._waits_since_s = self._unresponsive_since_s = now_s()
        self._probe_at_s = 0.0
        self._backoff.reset()

    async def take_over(self) -> None:
        """Implement `AsyncioDrive.take_over`. Frames have their full time to come, counted from
        now."""
        self.opened()
        self._received_s.update(dict.fromkeys((f.name for f in self.plan.watched), now_s()))
        await super().take_over()

    def _slot(self) -> None:
        """Do one step of the first job."""
        job = self.jobs[0]
        if job.done.done():  # its caller has given up
            self._drop(job)
            return
        try:
            if job.step is not None:
                self._job_s = now_s()
                self._runner.run(job, str(self))
            if job.step is None:
                self._drop(job)
                self._finished(job)
        except (NoReply, Refused, DriveFault) as error:
            self._drop(job)
            job.fail(error)
            if job.name == "configure":
                self._unresponsive(error)

    def _armed(self) -> None:
        super()._armed()
        self._may_turn = True
        self._sent_s = now_s()

    def _configured(self) -> None:
        self._cycles = 0
        self._unanswered.clear()
        self._set_up_backoff.reset()
        self._set_up_at_s = 0.0
        self._may_turn = self.sent_motion = False
        if self.plan.hello is not None:  # its frames begin now
            self._received_s.update(dict.fromkeys((f.name for f in self.plan.watched), now_s()))
        super()._configured()

    # ----------------------------------------------------------------------------------- stopping
    def _powerless(self) -> None:
        """Implement `AsyncioDrive._powerless`. A drive without power gets no zero either."""
        super()._powerless()
        self.sent_motion = False

    async def send_power_off(self) -> bool:
        """Implement `AsyncioDrive.send_power_off`. The CAN bus takes frames even when the cable is
        cut, so the drive has to report that it has no power. If it cannot report that, it has to
        respond."""
        if self._is_off():
            return True
        suffices = self._needs_no_report()
        self._powerless()
        if await self._write_now(self.plan.profile.disarm):
            return False
        if not self._last_off.is_sent:
            self._forget_enabled()
        self._last_off.sent(now_ns(), suffices=suffices)
        if self._is_off():
            return True
        for frame in (*self.plan.asked_fast, *(() if self.plan.hello else self.plan.probed)):
            self._ask(frame)
        return False

    def _needs_no_report(self) -> bool:
        place = self.plan.profile.enabled
        if self.state is DriveState.UNRESPONSIVE or self._missing() is not None:
            return False
        if place is None:
            return True
        reported_s = self._received_s.get(self.plan.read_frame_of(place.register).name, 0.0)
        off = self.plan.enabled(self._values) is False and reported_s > self._job_s
        return off and not self.sent_motion

    def _is_off(self) -> bool:
        return self._last_off.is_confirmed(
            reports_enabled=self.plan.profile.enabled is not None,
            enabled=self.plan.enabled(self._values),
            received_ns=round(max(self._received_s.values(), default=0.0) * 1e9),
        )

    @property
    def may_report(self) -> bool:
        """Implement `AsyncioDrive.may_report`."""
        return self._last_off.is_sent and self._missing() is None

    @property
    def has_stopped_itself(self) -> bool:
        """Implement `AsyncioDrive.has_stopped_itself`."""
        return left_alone(self._sent_s, now_s(), self._watchdog_s)

    def _is_at_rest(self) -> bool:
        readings = [self.plan.reading(joint, self._values) for joint in self.plan.joints]
        return all(one is not None and self._rests_at(one.velocity_rad_s) for one in readings)

    def _write_all(self, steps: Sequence[Step]) -> bool:
        """Send all writes at once, each even if the CAN bus did not take the one before."""
        sent = [self._write(*one) for one in merged_writes(self.plan, steps)]
        return all(sent)

    async def _write_now(self, steps: Sequence[Step]) -> Sequence[Step]:
        """Implement `AsyncioDrive._write_now`. Returns all steps if the CAN bus does not take
        one."""
        return () if self._write_all(steps) else steps
