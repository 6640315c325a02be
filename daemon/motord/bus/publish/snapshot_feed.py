# SPDX-License-Identifier: Apache-2.0
"""The feed of a publisher in the daemon: the newest snapshot, at the publisher's own rate. The
daemon never waits for it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from typing import Any

from motord.api.snapshot import Snapshot
from motord.base.wall_clock import WallClock


class SnapshotFeed:
    """Holds one snapshot between the daemon, which never waits, and one publisher."""

    def __init__(self, robot: str, rate_hz: float, clock: WallClock | None = None) -> None:
        """`clock`: gives the wall times; the process has one."""
        self._robot = robot
        self._clock = clock or WallClock()
        self._period_ns = round(1e9 / rate_hz)
        self._due_ns, self._last_ns = 0, -1
        self._newest: tuple[Snapshot, Mapping[str, Any] | None, int] | None = None
        """Snapshot, battery, and the snapshot's wall time."""
        self._filled = asyncio.Event()
        self.taken = 0
        self.dropped = 0
        """Snapshots that were replaced by newer ones before the publisher took them."""

    def report(self) -> dict[str, Any]:
        """Return the counts for `status`, in the form of `motord.bus.feed.Feed.report`; the state
        is the only topic."""
        state = {"rate_hz": round(1e9 / self._period_ns, 3), "taken": self.taken}
        return {"taken": self.taken, "dropped": self.dropped, "topics": {"state": state}}

    def offer(self, snapshot: Snapshot, battery: Mapping[str, Any] | None = None) -> None:
        """Keep a snapshot whose time has come, by its own stamp. Missed times are not made up for.
        `battery`: the battery of `status`; None: it is not measured."""
        if snapshot.stamp_ns < self._due_ns or snapshot.stamp_ns <= self._last_ns:
            return
        self._last_ns = snapshot.stamp_ns
        self._due_ns = max(self._due_ns + self._period_ns, snapshot.stamp_ns)
        self.dropped += self._newest is not None
        self._clock.look()
        self._newest = snapshot, battery, self._clock.wall_ns(snapshot.stamp_ns)
        self._filled.set()

    async def __aiter__(self) -> AsyncIterator[bytes]:
        """Yield each snapshot as one JSON object, without a line end."""
        while True:
            await self._filled.wait()
            self._filled.clear()
            newest, self._newest = self._newest, None
            if newest is not None:
                self.taken += 1
                snapshot, battery, wall_ns = newest
                yield encode(self._robot, snapshot, wall_ns, battery)


def encode(
    robot: str, snapshot: Snapshot, wall_ns: int, battery: Mapping[str, Any] | None = None
) -> bytes:
    """Return the snapshot as JSON, with its robot's name and its wall time, which it does not
    contain itself."""
    shown = {"robot": robot, "wall_time_s": wall_ns / 1e9, **snapshot.to_json()}
    if battery is not None:
        shown["battery"] = battery
    return json.dumps(shown, allow_nan=False, separators=(",", ":")).encode()
