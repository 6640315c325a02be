# SPDX-License-Identifier: Apache-2.0
"""The second process at work: it looks at the state page, asks the daemon for the rest, and feeds
the adapters. Nothing here can make the daemon wait."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from motord.bus.adapters import INPUT_POINTS, INPUTS, PUBLISHER_POINTS, PUBLISHERS, Adapter, find
from motord.bus.feed import Feed, Form, as_message
from motord.bus.guard import keep
from motord.bus.inputs.gap import Gap
from motord.bus.link import NotConnected, Source, Standby, call
from motord.bus.messages import Body
from motord.bus.topics import View
from motord.client import ClientError
from motord.config import (
    BusInput,
    OtherInput,
    OtherPublish,
    RclpyInput,
    Robot,
    StdoutPublish,
    UdpPublish,
)
from motord.deadline import within
from motord.snapshot import Snapshot
from motord.state_page import NoPage, StatePage

ATTACH_AGAIN_S = 0.5
STATUS_EVERY_S = 1.0
LOOK_MIN_S, LOOK_MAX_S = 0.001, 0.1
LOOKS_PER_SAMPLE = 2
TO_REST = ("stop", "estop", "disarm")
"""Calls for which a connection to the daemon is kept."""

BROKEN = (
    *(ArithmeticError, AssertionError, AttributeError, NameError, RuntimeError),
    *(SyntaxError, TypeError),
)
"""How code of another package fails that was never tried."""

_log = logging.getLogger(__name__)


class Station:
    """What adapters are given: the robot, its newest state, feeds of it, and a way to command."""

    def __init__(self, robot: Robot, path: Path) -> None:
        """`path`: the daemon's socket."""
        self.robot = robot
        self.path = path
        self.body = Body(robot=robot.robot.name, joints=tuple(robot.joint))
        self.view: View | None = None
        """None: the daemon has not been seen, or is gone."""
        self.feeds: dict[str, Feed] = {}
        self.sources: dict[str, Source] = {}
        self._standby = {method: Standby(path, method) for method in TO_REST}
        self._gaps: list[Gap] = []
        self._failures: dict[str, int] = {}
        """How often the adapter of a section has failed, where it has."""
        self._asked = asyncio.Event()

    # ------------------------------------------------------------------------------- for adapters
    def feed(self, name: str, rates_hz: Mapping[str, float], form: Form = as_message) -> Feed:
        """Topics by their rates, for the adapter of that name."""
        self.feeds[name] = Feed(self.body, rates_hz, form)
        return self.feeds[name]

    def source(self, name: str) -> Source:
        """The right to command of [input.NAME]; the adapter runs it."""
        self.sources[name] = Source(self.path, name)
        return self.sources[name]

    def gap(self, longest_s: float) -> Gap:
        """Tells whether this process has just stood still for longer than that."""
        self._gaps.append(Gap(longest_s))
        return self._gaps[-1]

    async def call(self, method: str, **params: Any) -> Any:
        """Ask the daemon. Raises Refused and ClientError."""
        try:
            return await call(self.path, method, **params)
        except NotConnected:
            standby = self._standby.get(method)
            if params or standby is None or not standby.ready:
                raise
        return await standby.call()

    def beside_robot_file(self, name: str) -> Path:
        """A file that the robot file names: beside it, unless its path is absolute."""
        return self.robot.path.parent / name

    def figures(self) -> dict[str, Any]:
        """What went through, for the daemon's `status`."""
        told = {
            name: {"taken": feed.taken, "dropped": feed.dropped}
            for name, feed in self.feeds.items()
        }
        commanding = {
            name: {
                "sent": source.sent,
                "lost": source.lost,
                "refused": source.refused,
                "lease": source.ready,
            }
            for name, source in self.sources.items()
        }
        return {"publishers": told, "inputs": commanding, "failures": self._failures}

    # ------------------------------------------------------------------------------------ at work
    async def run(self) -> None:
        """Until cancelled."""
        adapters = self._adapters()
        async with asyncio.TaskGroup() as tasks:
            for where, adapter in adapters.items():
                tasks.create_task(keep(where, adapter, self._failures))
            for standby in self._standby.values():
                tasks.create_task(standby.run())
            for gap in self._gaps:
                tasks.create_task(gap.watch())
            tasks.create_task(self._look())
            tasks.create_task(self._ask())

    def _adapters(self) -> dict[str, Adapter]:
        """By their sections."""
        publishers, inputs = (PUBLISHERS, PUBLISHER_POINTS), (INPUTS, INPUT_POINTS)
        sections: list[tuple[str, Any, tuple[Mapping[str, str], str]]] = [
            (f"publish.{name}", section, publishers)
            for name, section in self.robot.publish.items()
            if not isinstance(section, StdoutPublish | UdpPublish)
        ]
        sections += [
            (f"input.{name}", section, inputs)
            for name, section in self.robot.input.items()
            if isinstance(section, BusInput) and not isinstance(section, RclpyInput)
        ]
        made = {where: self._adapter(where, section, *kinds) for where, section, kinds in sections}
        return {where: adapter for where, adapter in made.items() if adapter is not None}

    def _adapter(
        self, where: str, section: Any, table: Mapping[str, str], group: str
    ) -> Adapter | None:
        """None, and a word in the log, for one that cannot be had: the others go on without it."""
        other = isinstance(section, OtherPublish | OtherInput)
        kind = section.adapter if other else section.kind
        try:
            adapter: Adapter = find(where, kind, table, group)(
                where.partition(".")[2], section, self
            )
        except ImportError as error:
            _log.error("%s is off: %s: pip install 'motord[%s]'", where, error, kind)
        except (LookupError, OSError, ValueError) as error:
            _log.error("%s is off: %s", where, error)
        except BROKEN as error:
            text = "%s is off: it cannot be made: %s: %s"
            _log.error(text, where, type(error).__name__, error, exc_info=error)
        else:
            return adapter
        return None

    async def _look(self) -> None:
        """Feed what the state page says, as long as there is one."""
        said = False
        while True:
            try:
                with StatePage.open(self.robot.robot.name) as page:
                    said = False
                    await self._watch(page)
            except NoPage as error:
                if not said:
                    _log.warning("no state yet: %s", error)
                    said = True
            self.view = None
            await asyncio.sleep(ATTACH_AGAIN_S)

    async def _watch(self, page: StatePage) -> None:
        """Until the page is gone."""
        number, checked_s = 0, time.monotonic()
        while True:
            if page.published != number and (snapshot := page.read()) is not None:
                number = page.published
                self._tell(snapshot)
            now_s = time.monotonic()
            if now_s - checked_s > ATTACH_AGAIN_S:
                checked_s = now_s
                if page.gone:
                    return
            await asyncio.sleep(self._period_s())

    def _period_s(self) -> float:
        fastest_s = min((feed.period_s for feed in self.feeds.values()), default=LOOK_MAX_S)
        return min(max(fastest_s / LOOKS_PER_SAMPLE, LOOK_MIN_S), LOOK_MAX_S)

    def _tell(self, snapshot: Snapshot) -> None:
        before = self.view
        if before is not None and before.snapshot.owner != snapshot.owner:
            self._asked.set()  # somebody else commands: who, only the daemon knows
        self.view = View(
            snapshot=snapshot,
            status=before.status if before else None,
            status_ns=before.status_ns if before else 0,
        )
        for feed in self.feeds.values():
            feed.offer(self.view)

    async def _ask(self) -> None:
        """The daemon's own words, from time to time and when somebody else commands."""
        while True:
            try:
                asked_ns, status = time.monotonic_ns(), await self.call("status")
            except ClientError:
                pass  # it is ending, or not there yet: the state page says so too
            else:
                if self.view is not None:
                    self.view = View(snapshot=self.view.snapshot, status=status, status_ns=asked_ns)
            try:
                async with within(STATUS_EVERY_S):
                    await self._asked.wait()
            except TimeoutError:
                pass
            self._asked.clear()
