# SPDX-License-Identifier: Apache-2.0
"""The steps of a job on a CAN bus: a write is a frame that goes out, a wait looks at frames that
have come after it began."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from motord_hal.can.plan import CanPlan, Sent
from motord_hal.clock import now_s
from motord_hal.drives.can_profile import Frame
from motord_hal.drives.profile import Step
from motord_hal.errors import DriveFault, NoReply
from motord_hal.modbus.job import Job

READ_WITHIN_S = 1.0
"""For a wait that says no time: one value is read."""


class StepRunner:
    """Works off the steps of one drive's jobs, one write or look a call."""

    def __init__(self, plan: CanPlan, send: Callable[[Sent], bool]) -> None:
        self._plan = plan
        self._send = send
        self._step: Step | None = None
        """The wait that is going on."""
        self._raw: int | None = None
        """What has come for it since it began."""

    def heard(self, values: dict[str, int]) -> None:
        """A frame has come."""
        if self._step is not None and self._step.register in values:
            self._raw = values[self._step.register]

    def run(self, job: Job, who: str) -> None:
        """Go on with the job's current step. Raises NoReply and DriveFault when a wait is over."""
        step = job.step
        assert step is not None  # the caller has looked
        if step.value is None:
            self._wait(job, step, who)
        elif self._send(next(merged_writes(self._plan, writes_ahead(job)))):
            self._advance_writes(job)

    def _advance_writes(self, job: Job) -> None:
        """Past all writes that went out in that frame."""
        ahead = writes_ahead(job)
        first = self._plan.frame_of(ahead[0].register)
        for step in ahead:
            if self._plan.frame_of(step.register) is not first:
                break
            job.advance()

    def _wait(self, job: Job, step: Step, who: str) -> None:
        if self._step is not step or job.wait_until_s is None:
            self._step, self._raw = step, None
            job.wait_until_s = now_s() + (step.within_s or READ_WITHIN_S)
        frame = self._plan.frame_of(step.register)
        if self._raw is not None:
            job.raw = self._raw
            if self._raw & step.mask == step.equals:
                self._step = None
                job.advance()
                return
        if now_s() > job.wait_until_s:
            raw, self._step = self._raw, None
            wanted = f"{step.register} is not {step.equals or 0:#x}"
            within = f"after {step.within_s or READ_WITHIN_S:g} s"
            if raw is None:
                raise NoReply(f"{who}: {job.name}: no {frame.name} frame {within}")
            raise DriveFault(f"{who}: {job.name}: {wanted} but {raw:#x} {within}")
        question = self._plan.question(frame)
        if question is not None and not frame.period_s:
            self._send(question)


def writes_ahead(job: Job) -> list[Step]:
    """The writes from the current step on, up to the next wait."""
    ahead = []
    for step in job.steps_ahead:
        if step.value is None:
            break
        ahead.append(step)
    return ahead


def merged_writes(plan: CanPlan, steps: Iterable[Step]) -> Iterator[Sent]:
    """Frames for the writes among the steps, in their order; neighbours in a frame go together."""
    frame: Frame | None = None
    raw: dict[str, int] = {}
    for step in steps:
        if step.value is None:
            continue
        own = plan.frame_of(step.register)
        if frame is not None and own is not frame:
            yield plan.write(frame, raw)
            raw = {}
        frame = own
        raw[step.register] = step.value
    if frame is not None:
        yield plan.write(frame, raw)
