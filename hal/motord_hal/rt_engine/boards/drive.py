# SPDX-License-Identifier: Apache-2.0
"""A board whose cycle runs in C: what asyncio does for it."""

from __future__ import annotations

import asyncio
from typing import Any

from motord_hal.base.clock import now_s
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.faults import Say
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.realtime.board import BoardThread
from motord_hal.rt_engine.boards.jobs import BoardJobs
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.drive import RtDrive

LOOK_EVERY_S = 0.01
START_GRACE_S = 2.5
"""An Arduino restarts when its port is opened, and its boot loader waits for two seconds."""


class BoardRtDrive(RtDrive):
    """The one drive of its line. Whether it responds is judged by what C has received."""

    def __init__(
        self,
        jobs: BoardJobs,
        spec: LineSpec,
        thread: BoardThread,
        notifier: Notifier,
        say: Say,
        silence_s: float,
    ) -> None:
        super().__init__(0, jobs, spec.watchdog_s, thread, notifier, say)
        self.jobs = jobs
        self._board = thread
        self._silence_s = silence_s

    def __str__(self) -> str:
        return f"the board of {', '.join(self.names)}"

    def _why_unresponsive(self, report: Any) -> str:
        del report
        return f"nothing for {self._silence_s * 1e3:.0f} ms"

    async def _present(self) -> None:
        """Wait until it sends. A board that restarts when its port is opened needs more time."""
        patience_s = now_s() + START_GRACE_S
        while not self._board.report().drives[0].received_ns:
            if now_s() > patience_s:
                self._failed_setup = True
                self._is_unresponsive(f"nothing for {START_GRACE_S:g} s")
            await asyncio.sleep(LOOK_EVERY_S)

    def _arming_steps(self) -> tuple[Step, ...]:
        """Every frame carries zero until it is armed: nothing has to be written before."""
        return self.jobs.profile.arm

    async def enable(self, began: int) -> None:
        """As RtDrive.enable, after a power-off in progress."""
        if self._powering_off is not None:
            await asyncio.shield(self._powering_off)
        await super().enable(began)
