# SPDX-License-Identifier: Apache-2.0
"""The feed of an adapter in the second process: each topic at its own rate, only its newest
message."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Mapping
from typing import Any, NamedTuple, Protocol

from motord.bus.messages.forms import Form, as_message
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import TOPICS, Topic, View, wall_offset_ns

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

    def __init__(self, body: Body, rates_hz: Mapping[str, float], form: Form = as_message) -> None:
        """`rates_hz`: rate of each topic. Raises KeyError for an unknown topic."""
        self._make = {name: form(TOPICS[name], body) for name in rates_hz}
        self._period_ns = {name: round(1e9 / rate_hz) for name, rate_hz in rates_hz.items()}
        self._due_ns = dict.fromkeys(rates_hz, 0)
        self._newest: dict[str, View] = {}
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
        """Keep the view for each topic whose time has come, by the view's stamp. Missed times of a
        topic are not made up for."""
        stamp_ns = view.snapshot.stamp_ns
        for name, due_ns in self._due_ns.items():
            if stamp_ns < due_ns:
                continue
            next_ns = due_ns + self._period_ns[name]
            self._due_ns[name] = max(next_ns, stamp_ns)
            self.dropped += name in self._newest
            self._newest[name] = view
            self._filled.set()

    async def __aiter__(self) -> AsyncIterator[TopicMessage]:
        """Yield each message when the reader takes it. Topics without a message are left out; a
        message that does not fit its form is lost."""
        while True:
            await self._filled.wait()
            self._filled.clear()
            newest, self._newest = self._newest, {}
            offset_ns = wall_offset_ns()
            for name, view in newest.items():
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
