# SPDX-License-Identifier: Apache-2.0
"""The part in asyncio of a drive on a CAN bus whose cycle runs in C: set-up, arming, reports."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from motord_hal.base.clock import now_s
from motord_hal.base.retry import Backoff
from motord_hal.can.plan import FIRST_WORD_S
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.faults import Say
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.realtime.can import CanThread
from motord_hal.rt_engine.can.jobs import CanJobs
from motord_hal.rt_engine.can.table import inputs_of, silence_s
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.drive import RtDrive

PROBE_FIRST_S = 0.1
PROBE_LIMIT_S = 2.0


class CanRtDrive(RtDrive):
    """Drive number `index` of the line's table. Frames received in C show that it responds."""

    def __init__(
        self,
        index: int,
        jobs: CanJobs,
        spec: LineSpec,
        thread: CanThread,
        notifier: Notifier,
        say: Say,
    ) -> None:
        super().__init__(index, jobs, spec, thread, notifier, say)
        self.jobs = jobs
        self._bus = thread
        self._cycle_s = 1.0 / spec.cycle_hz
        plan = jobs.plan
        self._inputs = inputs_of(plan)
        self._silences_s = [silence_s(plan, spec, frame) for frame in self._inputs]
        self._probes = plan.probed if plan.hello is None else (plan.hello,)
        self._faults = 0
        """Number of the drive's stopping faults that were already reported."""

    def __str__(self) -> str:
        return f"{', '.join(self.names)} (node {self.jobs.unit})"

    def update(self, report: Any, fault_words: Sequence[int]) -> None:
        """Extend `RtDrive.update`: report a fault also if the stop that C sent because of it has
        already cleared it in the drive."""
        if report.faults > self._faults:
            for joint in self.jobs.joints:
                if joint.index == report.last_fault_joint:
                    self.faults[joint.name].update(report.last_fault)
        self._faults = report.faults
        super().update(report, fault_words)

    def _why_unresponsive(self, report: Any) -> str:
        if not report.missing:
            return "its frames were missing"
        frame, silent_s = (these[report.missing - 1] for these in (self._inputs, self._silences_s))
        return f"no {frame.name} frame" + (f" for {silent_s:.2g} s" if silent_s else "")

    async def _present(self) -> None:
        """Wait until the drive's frames come; request those that it does not send by itself."""
        patience_s = now_s() + max(self._silences_s, default=0.0) + FIRST_WORD_S
        backoff, probe_s = Backoff(PROBE_FIRST_S, PROBE_LIMIT_S), 0.0
        while (report := self._bus.report().drives[self._index]).missing:
            if now_s() > patience_s:
                self._failed_setup = True
                self._is_unresponsive(self._why_unresponsive(report))
            if now_s() > probe_s:
                probe_s = now_s() + backoff.next_s()
                for frame in self._probes:
                    self.jobs.ask(frame)
            await asyncio.sleep(self._cycle_s)

    def _arming_steps(self) -> tuple[Step, ...]:
        plan, arm = self.jobs.plan, self.jobs.profile.arm
        if plan.profile.goes_to_positions:  # at rest, C sends its present position
            positions = {plan.channel(joint).position or "" for joint in plan.joints}
            known = (Step(register=name, mask=0, equals=0) for name in sorted(positions))
            return (*known, *arm)
        rest = (Step(register=name, value=raw) for name, raw in plan.setpoints({}).items())
        return (*rest, *arm)

    async def enable(self, began: int) -> None:
        """Extend `RtDrive.enable`: wait first for the end of a power-off."""
        if self._powering_off is not None:
            await asyncio.shield(self._powering_off)
        await super().enable(began)

    async def write_register(self, register: str, steps: Sequence[Step]) -> float:
        """Implement `RtDrive.write_register`; return the value that was read back."""
        job = Job("write", steps)
        await self.jobs.finish(job)
        return self.profile.registers[register].to_si(job.raw)
