# SPDX-License-Identifier: Apache-2.0
"""Jobs of one drive on a CAN bus whose cycle runs in C. Their frames go out as orders; during a job
the thread passes the frames of the drive to Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from motord_hal.base.clock import NS_PER_S, now_ns
from motord_hal.base.errors import NoReply
from motord_hal.can.job_step import StepRunner
from motord_hal.can.plan import CanPlan, with_cycle
from motord_hal.drives.can_profile import Frame
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.job import Job
from motord_hal.realtime.can import CanDriveReport, CanThread
from motord_hal.realtime.thread import Plain
from motord_hal.rt_engine.can.table import packet, write
from motord_hal.rt_engine.orders import ARM, ORDER_WITHIN_S, OrderJobs
from motord_hal.rt_engine.rs485.request_queue import Check, always


class CanJobs(OrderJobs):
    """Jobs of drive number `index` of the line's table. `take_in` takes the received frames from
    the thread and passes them to `received`."""

    def __init__(
        self,
        index: int,
        plan: CanPlan,
        thread: CanThread,
        cycle_s: float,
        take_in: Callable[[], None],
    ) -> None:
        name = f"{', '.join(joint.name for joint in plan.joints)} (node {plan.node})"
        super().__init__(index, name, thread, cycle_s)
        self.plan = plan
        self.profile = with_cycle(plan.profile, cycle_s)
        self.joints = plan.joints
        self.unit = plan.node
        self._thread = thread
        self._take_in = take_in
        self._runners: list[StepRunner] = []

    def received(self, frame: Frame, values: dict[str, int]) -> None:
        """Pass a received frame to the running jobs."""
        for runner in self._runners:
            runner.received(frame, values)

    async def run(
        self, name: str, steps: Sequence[Step], *, urgent: bool = False, check: Check = always
    ) -> int:
        """Do the steps in order; call `check` before each. Return the raw value that the newest
        wait has read. Raise HalError if a step fails."""
        job = Job(name, steps)
        await self.finish(job, urgent=urgent, check=check)
        return job.raw

    async def finish(self, job: Job, *, urgent: bool = False, check: Check = always) -> None:
        """Run a job that the caller made. Afterwards `job.raw` has the value that it read."""
        async with self._in_turn(urgent=urgent):
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
                if not await self._all_sent(dropped):
                    why = "a frame was not sent: stopped, or the CAN bus is full"
                    raise NoReply(f"{self._name}: {job.name}: {why}")
        finally:
            self._runners.remove(runner)
            self._thread.listen(self._index, wanted=bool(self._runners))

    def _drive_report(self) -> CanDriveReport:
        return self._thread.report().drives[self._index]

    def _ordered(self) -> int:
        return self._thread.ordered(self._index)

    def _write(self, frame: Frame, raw: Mapping[str, int], stops: int | None) -> bool:
        return self._order(write(self.plan, frame, raw), stops)

    def ask(self, frame: Frame) -> bool:
        """Request a frame of the drive. Return False if no request was sent."""
        question = self.plan.question(frame)
        if question is None or question == self.plan.sync:  # the cycle sends a sync
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
