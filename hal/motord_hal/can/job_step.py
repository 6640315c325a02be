# SPDX-License-Identifier: Apache-2.0
"""The steps of a job on a CAN bus. A write sends a frame; a wait checks frames that came after its
beginning."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from motord_hal.base.clock import now_s
from motord_hal.base.errors import DriveFault, NoReply, Refused
from motord_hal.can.plan import CanPlan
from motord_hal.drives.can_profile import Frame
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.job import Job

READ_WITHIN_S = 1.0
"""Time limit of a wait without one of its own, which reads one value."""
CONFIRM_WITHIN_S = 0.5
"""Time limit for the confirmation of a write."""

Write = Callable[[Frame, Mapping[str, int]], bool]
"""Function that writes signals. It returns False if the CAN bus takes nothing now."""


class StepRunner:
    """Executor of the steps of one drive's jobs, with one write or check in each call."""

    def __init__(self, plan: CanPlan, write: Write, ask: Callable[[Frame], bool]) -> None:
        self._plan = plan
        self._write = write
        self._ask = ask
        self._step: Step | None = None
        """Current wait, or a write that is not confirmed yet."""
        self._raw: int | None = None
        """Newest raw value that came for this step since its beginning; None: no value yet."""
        self._confirmed = False
        self._aborted: int | None = None

    def received(self, frame: Frame, values: dict[str, int]) -> None:
        """Note a frame that has come."""
        step = self._step
        if step is None:
            return
        if frame.name == self._plan.table.abort:
            self._aborted = next(iter(values.values()))
        elif step.value is not None:
            self._confirmed |= frame.name == self._plan.frame_of(step.register).confirm
        elif frame is self._plan.read_frame_of(step.register):
            self._raw = values[step.register]

    def run(self, job: Job, who: str) -> None:
        """Continue the job's current step. Raises NoReply, Refused or DriveFault if it failed."""
        step = job.step
        assert step is not None  # the caller has checked it
        if step.value is None:
            self._wait(job, step, who)
        elif self._plan.frame_of(step.register).confirm:
            self._write_confirmed(job, step, who)
        elif self._write(*next(merged_writes(self._plan, writes_ahead(job)))):
            self._advance_writes(job)

    def _advance_writes(self, job: Job) -> None:
        """Advance the job past all writes that went out in one frame."""
        ahead = writes_ahead(job)
        first = self._plan.frame_of(ahead[0].register)
        for step in ahead:
            if self._plan.frame_of(step.register) is not first:
                break
            job.advance()

    def _begin(self, job: Job, step: Step, within_s: float) -> bool:
        """Start the step's time limit unless it runs. Return whether the step begins with this
        call."""
        if self._step is step and job.wait_until_s is not None:
            return False
        self._step, self._raw, self._confirmed, self._aborted = step, None, False, None
        job.wait_until_s = now_s() + within_s
        return True

    def _check_abort(self, job: Job, step: Step, who: str) -> None:
        if self._aborted is not None:
            code, self._step = self._aborted, None
            raise Refused(f"{who}: {job.name}: {step.register} refused with {code:#010x}", code)

    def _write_confirmed(self, job: Job, step: Step, who: str) -> None:
        if self._begin(job, step, CONFIRM_WITHIN_S):
            went = self._write(self._plan.frame_of(step.register), {step.register: step.value or 0})
            self._step = step if went else None
            return
        self._check_abort(job, step, who)
        if self._confirmed:
            self._step = None
            job.advance()
        elif now_s() > (job.wait_until_s or 0.0):
            self._step = None
            raise NoReply(f"{who}: {job.name}: {step.register} was not confirmed")

    def _wait(self, job: Job, step: Step, who: str) -> None:
        begins = self._begin(job, step, step.within_s or READ_WITHIN_S)
        self._check_abort(job, step, who)
        frame = self._plan.read_frame_of(step.register)
        came, self_asked = self._raw, not frame.period_s
        if came is not None:
            job.raw, self._raw = came, None if self_asked else came
            if came & step.mask == step.equals:
                self._step = None
                job.advance()
                return
        if now_s() > (job.wait_until_s or 0.0):
            self._step = None
            within = f"after {step.within_s or READ_WITHIN_S:g} s"
            if came is None:
                raise NoReply(f"{who}: {job.name}: no {frame.name} frame {within}")
            wanted = f"{step.register} is {came & 0xFFFFFFFF:#x} {within}"
            raise DriveFault(f"{who}: {job.name}: {wanted}, not {step.equals or 0:#x}")
        if self_asked and (begins or came is not None or not self._plan.table.abort):
            self._ask(frame)


def writes_ahead(job: Job) -> list[Step]:
    """Return the writes from the current step on, up to the next wait."""
    ahead = []
    for step in job.steps_ahead:
        if step.value is None:
            break
        ahead.append(step)
    return ahead


def merged_writes(
    plan: CanPlan, steps: Iterable[Step]
) -> Iterator[tuple[Frame, Mapping[str, int]]]:
    """Yield the frames for the writes among the steps, in order, with their raw values. Neighbours
    in the same frame are sent together."""
    frame: Frame | None = None
    raw: dict[str, int] = {}
    for step in steps:
        if step.value is None:
            continue
        own = plan.frame_of(step.register)
        if frame is not None and own is not frame:
            yield frame, raw
            raw = {}
        frame = own
        raw[step.register] = step.value
    if frame is not None:
        yield frame, raw
