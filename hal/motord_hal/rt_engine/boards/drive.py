# SPDX-License-Identifier: Apache-2.0
"""The part in asyncio of a board whose cycle runs in C: set-up, arming, reports."""

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
"""Time for a board to send its first feedback after its port was opened. An Arduino restarts when
its port is opened, and its boot loader waits for two seconds."""


class BoardRtDrive(RtDrive):
    """The board, the only drive of its line. Feedback received in C shows that it responds."""

    def __init__(
        self,
        jobs: BoardJobs,
        spec: LineSpec,
        thread: BoardThread,
        notifier: Notifier,
        say: Say,
        silence_s: float,
    ) -> None:
        super().__init__(0, jobs, spec, thread, notifier, say)
        self.jobs = jobs
        self._board = thread
        self._silence_s = silence_s

    def __str__(self) -> str:
        return f"the board of {', '.join(self.names)}"

    def _why_unresponsive(self, report: Any) -> str:
        del report
        return f"nothing for {self._silence_s * 1e3:.0f} ms"

    async def _present(self) -> None:
        """Wait until the board sends feedback. Report it as unresponsive only after START_GRACE_S,
        because it may restart when its port is opened."""
        patience_s = now_s() + START_GRACE_S
        while not self._board.report().drives[0].received_ns:
            if now_s() > patience_s:
                self._failed_setup = True
                self._is_unresponsive(f"nothing for {START_GRACE_S:g} s")
            await asyncio.sleep(LOOK_EVERY_S)

    def _arming_steps(self) -> tuple[Step, ...]:
        """Return the profile's steps alone: every frame carries zero until the board is armed, so
        that zero need not be written before."""
        return self.jobs.profile.arm

    async def enable(self, began: int) -> None:
        """Extend `RtDrive.enable`: wait first for the end of a power-off."""
        if self._powering_off is not None:
            await asyncio.shield(self._powering_off)
        await super().enable(began)
