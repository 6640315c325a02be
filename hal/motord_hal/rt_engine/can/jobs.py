# SPDX-License-Identifier: Apache-2.0
"""Jobs of one drive on a CAN bus whose cycle runs in C: frames go out as orders, and while a job
goes on the frames of the drive are handed on to here."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from motord_hal.base.clock import NS_PER_S, now_ns, now_s
from motord_hal.base.errors import HalError, NoReply
from motord_hal.can.job_step import StepRunner
from motord_hal.can.plan import CanPlan, with_cycle
from motord_hal.drives.can_profile import Frame
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.job import Job
from motord_hal.realtime.can import CanDriveReport, CanThread
from motord_hal.realtime.thread import Plain
from motord_hal.rt_engine.can.table import packet, write
from motord_hal.rt_engine.rs485.request_queue import Check, always

ORDER_WITHIN_S = 0.5
"""So long a frame may wait while the CAN bus takes nothing."""
SEEN_WITHIN_S = 1.0
ARM = "arm"
"""Of this job nothing is sent any more once a stop was sent to the drive."""


class CanJobs:
    """What can be done with drive number `index` of the line's table, one job at a time; an urgent
    one does not wait for its turn. `take_in` hands on what has come."""

    def __init__(
        self,
        index: int,
        plan: CanPlan,
        thread: CanThread,
        cycle_s: float,
        take_in: Callable[[], None],
    ) -> None:
        self.plan = plan
        self.profile = with_cycle(plan.profile, cycle_s)
        self.joints = plan.joints
        self.unit = plan.node
        self._index = index
        self._thread = thread
        self._cycle_s = cycle_s
        self._take_in = take_in
        self._name = f"{', '.join(joint.name for joint in plan.joints)} (node {plan.node})"
        self._turn = asyncio.Lock()
        self._runners: list[StepRunner] = []

    @property
    def request_limit_s(self) -> float:
        """Longest time until a frame is on the CAN bus, or will never be."""
        return self._cycle_s + ORDER_WITHIN_S

    def received(self, frame: Frame, values: dict[str, int]) -> None:
        """A frame has come."""
        for runner in self._runners:
            runner.received(frame, values)

    async def run(
        self, name: str, steps: Sequence[Step], *, urgent: bool = False, check: Check = always
    ) -> None:
        """Step by step; `check` is made before each. Raises HalError."""
        await self.finish(Job(name, steps), urgent=urgent, check=check)

    async def finish(self, job: Job, *, urgent: bool = False, check: Check = always) -> None:
        """As `run`, for a caller that needs what the job has read."""
        if urgent:
            await self._work(job, check)
            return
        async with self._turn:
            await self._work(job, check)

    async def _work(self, job: Job, check: Check) -> None:
        stops = await self._stops() if job.name == ARM else None
        dropped = self._drive_report().orders_dropped
        runner = StepRunner(
            self.plan,
            lambda frame, raw: self._write(frame, raw, stops),
            self.ask,
        )
        self._runners.append(runner)
        self._thread.listen(self._index, wanted=True)
        try:
            while job.step is not None:
                self._take_in()
                check()
                runner.run(job, self._name)
                await self._sent(job.name, dropped)
        finally:
            self._runners.remove(runner)
            self._thread.listen(self._index, wanted=bool(self._runners))

    def _drive_report(self) -> CanDriveReport:
        return self._thread.report().drives[self._index]

    async def _sent(self, name: str, dropped_before: int) -> None:
        """A cycle later, or when all that was ordered has gone out. Raises NoReply where some of it
        never will."""
        until_s = now_s() + ORDER_WITHIN_S + SEEN_WITHIN_S
        while now_s() < until_s:
            await asyncio.sleep(self._cycle_s)
            report = self._drive_report()
            if report.orders_dropped != dropped_before:
                break
            if report.orders_sent + report.orders_dropped == self._thread.ordered(self._index):
                return
        raise NoReply(
            f"{self._name}: {name}: a frame was not sent: stopped, or the CAN bus is full"
        )

    async def _stops(self) -> int:
        """How often C has stopped the drive, all requests so far included. Raises HalError."""
        requested = self._thread.requested(self._index)
        until_s = now_s() + SEEN_WITHIN_S
        while now_s() < until_s:
            report = self._drive_report()
            if report.request_seen == requested:
                return report.stops
            await asyncio.sleep(self._cycle_s)
        raise HalError(f"{self._name}: the line's thread does not answer")

    def _write(self, frame: Frame, raw: Mapping[str, int], stops: int | None) -> bool:
        return self._order(write(self.plan, frame, raw), stops)

    def ask(self, frame: Frame) -> bool:
        """Request a frame of the drive; False: it was not requested."""
        question = self.plan.question(frame)
        if question is None or question == self.plan.sync:  # that is the cycle's own
            return False
        return self._order({"packet": packet(question)}, None)

    def _order(self, plain: Plain, stops: int | None) -> bool:
        return self._thread.put_order(
            {
                "write": plain,
                "drive": self._index,
                "expires_ns": now_ns() + round(ORDER_WITHIN_S * NS_PER_S),
                "guarded": int(stops is not None),
                "stops": stops or 0,
            }
        )
