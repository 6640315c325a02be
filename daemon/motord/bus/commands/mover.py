# SPDX-License-Identifier: Apache-2.0
"""Carries out one motion at a time, under the lease of an input. It reads the state page and
commands again and again: when this process hangs or dies, the lease lapses and the robot stops."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from motord.api.motion import (
    CANNOT_STRAFE,
    STOPS_EVERY_S,
    Bounds,
    End,
    Goal,
    Motion,
    MotionStep,
    Plan,
    bounds_of,
    limit_names,
    obstacle,
    planned,
    problem,
)
from motord.api.snapshot import Snapshot
from motord.api.state_page import NoPage, StatePage
from motord.bus.commands.gap import STOOD_STILL, Gap
from motord.bus.commands.link import Source
from motord.client import ClientError
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

LOOKS_A_LEASE = 5
LOOK_MIN_S, LOOK_MAX_S = 0.005, 0.02


class NotNow(Exception):
    """A motion cannot begin; the text is the reason."""


class Mover:
    """The motions of one input. A command by that input itself ends the motion: the newest command
    counts."""

    def __init__(self, runtime: Runtime, source: Source, gap: Gap, lease_s: float) -> None:
        """`gap`: detects goals that may have waited here; a goal has no stamp, so such a goal is
        refused."""
        self._runtime = runtime
        self._source = source
        self._gap = gap
        self._lease_s = lease_s
        self._every_s = min(max(lease_s / LOOKS_A_LEASE, LOOK_MIN_S), LOOK_MAX_S)
        self.stale_s = runtime.robot.safety.feedback_timeout_s
        self._driven_s = -math.inf
        self._interrupted = False
        self._direct = 0
        """`Source.direct` when the motion began."""

    def driven(self, now_s: float | None = None) -> None:
        """Note a command of the same input."""
        self._driven_s = time.monotonic() if now_s is None else now_s
        self._interrupted = True

    async def plan(self, goal: Goal) -> Plan:
        """Return the plan of a motion. Raises NotNow if the motion is not possible, or not now."""
        if self._gap.just_over():
            raise NotNow(STOOD_STILL)
        try:
            if goal.strafes and not self._runtime.robot.base.strafes:
                raise NotNow(CANNOT_STRAFE)
            plan = planned(goal, await self._bounds(goal))
        except (ValueError, ClientError) as error:
            raise NotNow(str(error)) from error
        try:
            with self._runtime.page() as page:
                why = self._why_not(page.read())
        except NoPage as error:
            raise NotNow(str(error)) from error
        if why is not None:
            raise NotNow(why)
        return plan

    def _why_not(self, snapshot: Snapshot | None) -> str | None:
        if self._gap.just_over():
            return STOOD_STILL
        if time.monotonic() - self._driven_s < self._lease_s:
            return "cmd_vel commands"
        if not self._source.ready:
            return "there is no lease: the daemon takes no commands now"
        if snapshot is None:
            return "there is no state yet"
        if snapshot.owner not in (0, self._source.number):
            return "another source commands"
        return problem(snapshot, time.monotonic_ns(), self.stale_s) or obstacle(snapshot)

    async def _bounds(self, goal: Goal) -> Bounds:
        """Return the limits that are in force now. Raises ClientError."""
        sent = await self._runtime.call("params.get", names=limit_names(goal))
        return bounds_of(goal, sent)

    async def move(
        self, plan: Plan, report: Callable[[Motion, Snapshot], None], cancel: asyncio.Event
    ) -> tuple[MotionStep, Motion | None]:
        """Carry out a plan until its end; `report` is called at each look. Return the last step and
        the motion; motion None: it did not begin."""
        try:
            stops = await self._stops()
            with self._runtime.page() as page:
                start = page.read()
                why = self._why_not(start)
                if start is None or why is not None:
                    return MotionStep(end=End.ABORTED, why=why or ""), None
                self._interrupted, self._direct = False, self._source.direct
                motion = Motion(
                    plan,
                    start,
                    time.monotonic_ns(),
                    lease=self._source.number,
                    stale_s=self.stale_s,
                    stops=stops,
                )
                async with TaskGroup() as tasks:
                    counting = tasks.create_task(self._count_stops(motion))
                    step = await self._follow(motion, start, page, report, cancel)
                    counting.cancel()
                return step, motion
        except (NoPage, ClientError) as error:
            return MotionStep(end=End.ABORTED, why=str(error)), None

    async def _stops(self) -> int:
        """Return how many stops the daemon has counted until now. Raises ClientError."""
        return int((await self._runtime.call("status"))["stops"])

    async def _count_stops(self, motion: Motion) -> None:
        """Pass the daemon's count of stops to the motion, until cancelled."""
        while True:
            asked_ns = time.monotonic_ns()
            with contextlib.suppress(ClientError):  # nothing is corrected then
                motion.counted(await self._stops(), asked_ns)
            await asyncio.sleep(STOPS_EVERY_S)

    async def _follow(
        self,
        motion: Motion,
        newest: Snapshot,
        page: StatePage,
        report: Callable[[Motion, Snapshot], None],
        cancel: asyncio.Event,
    ) -> MotionStep:
        try:
            while True:
                newest = page.read() or newest
                if cancel.is_set():
                    motion.cancel(time.monotonic_ns())
                step = motion.step(newest, time.monotonic_ns())
                if self._interrupted or self._source.direct != self._direct:
                    return MotionStep(end=End.ABORTED, why="cmd_vel commands")
                if step.end is not None:
                    return step
                self._source.drive(
                    step.linear_m_s,
                    step.angular_rad_s,
                    lateral_m_s=step.lateral_m_s,
                    seen=self._direct,
                )
                report(motion, newest)
                await asyncio.sleep(self._every_s)
        finally:
            if not self._interrupted:  # otherwise another command steers the robot
                self._source.drive(0.0, 0.0, seen=self._direct)
                self._source.release(seen=self._direct)
