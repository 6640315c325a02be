# SPDX-License-Identifier: Apache-2.0
"""The feed of an adapter in the second process: each topic at most at its own rate, each
measurement once, and only the newest message."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Mapping
from typing import Any, NamedTuple, Protocol

from motord.base.wall_clock import WallClock
from motord.bus.messages.forms import Form, as_message, measured_ns
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import TOPICS, Topic, View

_log = logging.getLogger(__name__)


class TopicMessage(NamedTuple):
    """A message in the form of its feed, and its topic."""

    topic: Topic
    message: Any


class Sink(Protocol):
    """Takes views, counts what it has taken and lost, and never waits."""

    taken: int
    dropped: int

    @property
    def period_s(self) -> float:
        """Time between two views that it needs."""
        ...

    def offer(self, view: View) -> None:
        """Take a view, or drop it."""
        ...


class Feed:
    """Holds one view of each topic. Filling it never waits; a slow reader loses messages."""

    def __init__(
        self,
        body: Body,
        rates_hz: Mapping[str, float],
        form: Form = as_message,
        clock: WallClock | None = None,
    ) -> None:
        """`rates_hz`: rate of each topic. `clock`: gives the stamps; the process has one. Raises
        KeyError for an unknown topic."""
        self._make = {name: form(TOPICS[name], body) for name in rates_hz}
        self._measured_ns = {name: measured_ns(TOPICS[name], body) for name in rates_hz}
        self._last_ns = dict.fromkeys(rates_hz, -1)
        """Moment of the newest measurement that was taken."""
        self._clock = clock or WallClock()
        self._period_ns = {name: round(1e9 / rate_hz) for name, rate_hz in rates_hz.items()}
        self._due_ns = dict.fromkeys(rates_hz, 0)
        self._newest: dict[str, tuple[View, int]] = {}
        """Views, and the wall clock's offset at their measurement."""
        self._filled = asyncio.Event()
        self._failing = False
        self.taken = 0
        self.dropped = 0
        """Messages that were replaced by newer ones before they were taken, or did not fit their
        form."""
        self._taken_of = dict.fromkeys(rates_hz, 0)

    def report(self) -> dict[str, Any]:
        """Return the counts for `status`: messages that were taken and dropped, and for each topic
        its rate in Hz and the messages taken."""
        topics = {
            name: {"rate_hz": round(1e9 / self._period_ns[name], 3), "taken": taken}
            for name, taken in self._taken_of.items()
        }
        return {"taken": self.taken, "dropped": self.dropped, "topics": topics}

    @property
    def period_s(self) -> float:
        """Period of the fastest topic."""
        return min(self._period_ns.values()) / 1e9

    def offer(self, view: View) -> None:
        """Keep the view for each topic whose time has come, by the view's stamp, and of which it
        has a new measurement. Missed times of a topic are not made up for."""
        stamp_ns = view.snapshot.stamp_ns
        for name, due_ns in self._due_ns.items():
            if stamp_ns < due_ns:
                continue
            try:
                moment_ns = self._measured_ns[name](view)
            except ValueError as error:
                self._lose(error)
            else:
                if moment_ns is None or moment_ns <= self._last_ns[name]:
                    continue
                self._last_ns[name] = moment_ns
                self.dropped += name in self._newest
                self._newest[name] = view, self._clock.wall_ns(moment_ns) - moment_ns
                self._filled.set()
            self._due_ns[name] = max(due_ns + self._period_ns[name], stamp_ns)

    async def __aiter__(self) -> AsyncIterator[TopicMessage]:
        """Yield each message when the reader takes it. Topics without a message are left out; a
        message that does not fit its form is lost."""
        while True:
            await self._filled.wait()
            self._filled.clear()
            newest, self._newest = self._newest, {}
            for name, (view, offset_ns) in newest.items():
                try:
                    message = self._make[name](view, offset_ns)
                except ValueError as error:
                    self._lose(error)
                    continue
                if message is not None:
                    self.taken += 1
                    self._taken_of[name] += 1
                    yield TopicMessage(TOPICS[name], message)

    def _lose(self, error: ValueError) -> None:
        """Count a lost message, and log the first one."""
        self.dropped += 1
        if not self._failing:
            self._failing = True
            _log.warning("not published: %s", error)
