# SPDX-License-Identifier: Apache-2.0
"""Jobs of a board whose cycle runs in C. A written value stays in every later frame; a wait checks
the feedback that the board sends after it has received the writes."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from motord_hal.base.clock import now_s
from motord_hal.base.errors import DriveFault, NoReply
from motord_hal.drives.profile import Step
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.board import BoardDriveReport, BoardThread
from motord_hal.rt_engine.boards.layout import Layout, Plain
from motord_hal.rt_engine.boards.table import writes
from motord_hal.rt_engine.orders import ARM, OrderJobs
from motord_hal.rt_engine.rs485.request_queue import Check, always

WAIT_LEAST_S = 0.25
"""Least deadline of a step that waits: time for a frame to the board and one back."""


class BoardJobs(OrderJobs):
    """Runs the jobs of the board on a line."""

    def __init__(
        self, name: str, plan: DrivePlan, layout: Layout, thread: BoardThread, period_s: float
    ) -> None:
        super().__init__(0, name, thread, period_s)
        self.profile = plan.profile
        self.joints = plan.joints
        self.unit = plan.unit
        self._layout = layout
        self._thread = thread

    def value(self, register: str) -> int | None:
        """Return the newest raw value of a register; None: the board has not reported it."""
        return self._layout.raw(register, self._drive_report().payload)

    async def run(
        self, name: str, steps: Sequence[Step], *, urgent: bool = False, check: Check = always
    ) -> int:
        """Do the steps in order. Call `check` before each, and repeatedly during a wait. Return the
        raw value that the newest wait has read. Raise HalError if a step fails."""
        async with self._in_turn(urgent=urgent):
            return await self._work(name, steps, check)

    async def _work(self, name: str, steps: Sequence[Step], check: Check) -> int:
        raw = 0
        stops = await self._stops() if name == ARM else None
        for step in steps:
            check()
            if step.value is None:
                raw = await self._wait_for(name, step, check)
            for write in writes(self._layout, [step]):
                await self._write(name, write, stops)
        return raw

    def _drive_report(self) -> BoardDriveReport:
        return self._thread.report().drives[0]

    def _ordered(self) -> int:
        return self._thread.ordered

    async def _write(self, name: str, write: Plain, stops: int | None) -> None:
        """Pass a write to the thread, and wait until a frame with it has gone out."""
        dropped = self._drive_report().orders_dropped
        order = {
            "write": write,
            "guarded": int(stops is not None),
            "stops": stops or 0,
        }
        if not self._thread.put_order(order):
            raise NoReply(f"{self._name}: {name}: too many writes wait for the port")
        if not await self._all_sent(dropped):
            raise NoReply(f"{self._name}: {name}: not written: stopped, or the port takes no bytes")

    async def _wait_for(self, name: str, step: Step, check: Check) -> int:
        """Wait until the register has the value of the step, in feedback that the board made after
        it had received all writes."""
        until_s = now_s() + max(step.within_s, WAIT_LEAST_S)
        while True:
            report = self._drive_report()
            raw = self._layout.raw(step.register, report.payload)
            if report.knows and raw is not None and raw & step.mask == step.equals:
                return raw
            if now_s() > until_s:
                raise DriveFault(
                    f"{self._name}: {name}: {step.register} is {raw or 0:#x}, "
                    f"not {step.equals or 0:#x}, in {step.within_s:g} s"
                )
            await asyncio.sleep(self._cycle_s)
            check()
