# SPDX-License-Identifier: Apache-2.0
"""The work of the second process: it reads the state page, calls the daemon for everything else,
and feeds the adapters. Nothing here can make the daemon wait."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motord.aio import until_tick
from motord.api.deadline import within
from motord.api.halting import outcome
from motord.api.snapshot import Snapshot, rest_report
from motord.api.state_page import NoPage, StatePage
from motord.api.stop_request import KINDS
from motord.base.extras import how_to_install
from motord.base.wall_clock import WallClock
from motord.bus.adapters import (
    INPUT_POINTS,
    INPUTS,
    PUBLISHER_POINTS,
    PUBLISHERS,
    Adapter,
    Recorder,
    find,
)
from motord.bus.commands.gap import Gap
from motord.bus.commands.link import Source, StopSender, call
from motord.bus.feed import Feed, Sink
from motord.bus.guard import keep
from motord.bus.messages.forms import Form, as_message
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import View
from motord.client import ClientError, Refused
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.config import Robot

ATTACH_AGAIN_S = 0.5
STATUS_EVERY_S = 1.0
LOOK_MIN_S, LOOK_MAX_S = 0.001, 0.1
LOOKS_PER_VIEW = 2
CONFIRM_WITHIN_S = 2.0
CONFIRM_LOOK_EVERY_S = 0.02

BROKEN = (
    *(ArithmeticError, AssertionError, AttributeError, NameError, RuntimeError),
    *(SyntaxError, TypeError),
)
"""Errors that may come from code of another package that was never tried."""

_log = logging.getLogger(__name__)


def of_this_robot(section: Any, robot: Robot) -> Any:
    """Return the section without the topics of sensors that the robot does not have."""
    from motord.config import BusPublish

    if robot.imu is not None or not isinstance(section, BusPublish):
        return section
    topics = tuple(topic for topic in section.topics if topic != "imu")
    return section.model_copy(update={"topics": topics})


class Runtime:
    """What adapters can use: the robot, its newest state, feeds of it, and what is needed to
    command."""

    def __init__(self, robot: Robot, path: Path, clock: WallClock | None = None) -> None:
        """`path`: the daemon's socket."""
        self.robot = robot
        self.clock = clock or WallClock()
        """Gives all wall times that the adapters publish."""
        self.path = path
        self.body = Body(robot=robot.robot.name, joints=tuple(robot.joint))
        self.view: View | None = None
        """The newest view; None: the daemon has not been seen yet, or is gone."""
        self.feeds: dict[str, Sink] = {}
        self.sources: dict[str, Source] = {}
        self.recorders: dict[str, Recorder] = {}
        """Recorders by name: the [publish.*] of kind "mcap"."""
        self._stops = StopSender(path)
        self._gaps: list[Gap] = []
        self._failures: dict[str, int] = {}
        """Number of failures, by the section of the adapter that has failed."""
        self._asked = asyncio.Event()

    # ------------------------------------------------------------------------------- for adapters
    def feed(
        self,
        name: str,
        rates_hz: Mapping[str, float],
        form: Form = as_message,
        body: Body | None = None,
    ) -> Feed:
        """Create the feed of the adapter with that name. `body`: `self.body` unless given."""
        made = self.feeds[name] = Feed(body or self.body, rates_hz, form, self.clock)
        return made

    def source(self, name: str) -> Source:
        """Create the right to command of [input.NAME]; the adapter runs it."""
        self.sources[name] = Source(self.path, name)
        return self.sources[name]

    def gap(self, longest_s: float) -> Gap:
        """Return a detector of times in which this process stood still for longer than
        `longest_s`."""
        self._gaps.append(Gap(longest_s))
        return self._gaps[-1]

    async def call(self, method: str, **params: Any) -> Any:
        """Call the daemon. Raises Refused and ClientError."""
        if method in KINDS:
            return await self._halt(method, params)
        return await call(self.path, method, **params)

    async def _halt(self, method: str, params: dict[str, Any]) -> Any:
        """Request a stop by datagram, which also works when a connection is impossible. The
        daemon's answer confirms it, or the state page if there is no answer. Raises DaemonHangs."""
        requested_ns = time.monotonic_ns()
        sent = await self._stops.send(method)
        await until_tick(self.path, method)
        try:
            return await call(self.path, method, **params)
        except Refused:
            raise
        except ClientError:
            state = await self._outcome(method, requested_ns) if sent else None
            if state is None:
                raise
            known = self.view.snapshot if self.view is not None else None
            rest = {} if known is None else rest_report(known, self.body.joints)
            return {"state": state, **rest}

    async def _outcome(self, method: str, requested_ns: int) -> str | None:
        """Return the state in which the request ended, by the state page; None if the page does not
        show it in time."""
        with contextlib.suppress(TimeoutError):
            async with within(CONFIRM_WITHIN_S):
                while True:
                    if self.view is not None:
                        state = outcome(self.view.snapshot, method, requested_ns)
                        if state is not None:
                            return state
                    await asyncio.sleep(CONFIRM_LOOK_EVERY_S)
        return None

    def page(self) -> StatePage:
        """Open the robot's state page. Raises NoPage."""
        return StatePage.open(self.robot.robot.name)

    def beside_robot_file(self, name: str) -> Path:
        """Return the path of a file that the robot file names: beside it, unless the name is
        absolute."""
        return self.robot.path.parent / name

    def figures(self) -> dict[str, Any]:
        """Return counts of messages and commands, for the daemon's `status`."""
        publishers = {
            name: feed.report()
            if isinstance(feed, Feed)
            else {"taken": feed.taken, "dropped": feed.dropped}
            for name, feed in self.feeds.items()
        }
        commanding = {
            name: {
                "sent": source.sent,
                "lost": source.lost,
                "refused": source.refused,
                "lease": source.ready,
                "rivals": source.rivals(),
            }
            for name, source in self.sources.items()
        }
        return {
            "at_s": time.monotonic(),
            "publishers": publishers,
            "inputs": commanding,
            "failures": self._failures,
        }

    # ------------------------------------------------------------------------------------ at work
    async def run(self) -> None:
        """Run all adapters until cancelled."""
        adapters = self._adapters()
        with self._stops.open():
            async with TaskGroup() as tasks:
                for where, adapter in adapters.items():
                    tasks.create_task(keep(where, adapter, self._failures))
                for gap in self._gaps:
                    tasks.create_task(gap.watch())
                tasks.create_task(self._look())
                tasks.create_task(self._ask())

    def _adapters(self) -> dict[str, Adapter]:
        """Return the adapters by their sections."""
        from motord.config import BusInput, RclpyInput, StdoutPublish, UdpPublish

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
        made = {
            where: self._adapter(where, of_this_robot(section, self.robot), *kinds)
            for where, section, kinds in sections
        }
        return {where: adapter for where, adapter in made.items() if adapter is not None}

    def _adapter(
        self, where: str, section: Any, table: Mapping[str, str], group: str
    ) -> Adapter | None:
        """Create an adapter. If it cannot be created, log the reason and return None: the others go
        on without it."""
        kind = section.adapter if section.kind == "other" else section.kind
        try:
            adapter: Adapter = find(where, kind, table, group)(
                where.partition(".")[2], section, self
            )
        except ImportError as error:
            _log.error("%s is off: %s: %s", where, error, how_to_install(kind))
        except (LookupError, OSError, ValueError) as error:
            _log.error("%s is off: %s", where, error)
        except BROKEN as error:
            text = "%s is off: it cannot be created: %s: %s"
            _log.error(text, where, type(error).__name__, error, exc_info=error)
        else:
            return adapter
        return None

    async def _look(self) -> None:
        """Feed what the state page shows, as long as there is such a page."""
        reported = False
        while True:
            try:
                with self.page() as page:
                    reported = False
                    await self._watch(page)
            except NoPage as error:
                if not reported:
                    _log.warning("no state yet: %s", error)
                    reported = True
            self.view = None
            await asyncio.sleep(ATTACH_AGAIN_S)

    async def _watch(self, page: StatePage) -> None:
        """Feed what the page shows, until it is gone."""
        number, checked_s = 0, time.monotonic()
        while True:
            if page.published != number and (snapshot := page.read()) is not None:
                number = page.published
                self._feed(snapshot)
            now_s = time.monotonic()
            if now_s - checked_s > ATTACH_AGAIN_S:
                checked_s = now_s
                if page.gone:
                    return
            await asyncio.sleep(self._period_s())

    def _period_s(self) -> float:
        fastest_s = min((feed.period_s for feed in self.feeds.values()), default=LOOK_MAX_S)
        return min(max(fastest_s / LOOKS_PER_VIEW, LOOK_MIN_S), LOOK_MAX_S)

    def _feed(self, snapshot: Snapshot) -> None:
        before = self.view
        if before is not None and before.snapshot.owner != snapshot.owner:
            self._asked.set()  # only the daemon knows which source commands now
        if before is not None and before.snapshot.faults != snapshot.faults:
            self._asked.set()  # only the daemon knows the reason
        self.view = View(
            snapshot=snapshot,
            status=before.status if before else None,
            status_ns=before.status_ns if before else 0,
        )
        self.clock.look()
        for feed in self.feeds.values():
            feed.offer(self.view)

    async def _ask(self) -> None:
        """Call the daemon for its status, from time to time and when another source commands."""
        while True:
            try:
                asked_ns, status = time.monotonic_ns(), await self.call("status")
            except ClientError:
                pass  # it is ending, or not there yet: the state page shows that too
            else:
                if self.view is not None:
                    self.view = View(snapshot=self.view.snapshot, status=status, status_ns=asked_ns)
            try:
                async with within(STATUS_EVERY_S):
                    await self._asked.wait()
            except TimeoutError:
                pass
            self._asked.clear()
