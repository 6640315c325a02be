# SPDX-License-Identifier: Apache-2.0
"""What a publisher is fed: snapshots at its own rate, newest wins, and never any waiting."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Mapping
from typing import Any

from motord.api.snapshot import Snapshot


class SnapshotFeed:
    """Holds one snapshot between the daemon, which never waits, and one publisher."""

    def __init__(self, robot: str, rate_hz: float) -> None:
        self._robot = robot
        self._period_ns = round(1e9 / rate_hz)
        self._due_ns = 0
        self._newest: tuple[Snapshot, Mapping[str, Any] | None] | None = None
        self._filled = asyncio.Event()
        self.taken = 0
        self.dropped = 0
        """Replaced by a newer one before the publisher took it."""

    def report(self) -> dict[str, Any]:
        """For `status`: as motord.bus.feed.Feed has it; the state is the only topic."""
        state = {"rate_hz": round(1e9 / self._period_ns, 3), "taken": self.taken}
        return {"taken": self.taken, "dropped": self.dropped, "topics": {"state": state}}

    def offer(self, snapshot: Snapshot, battery: Mapping[str, Any] | None = None) -> None:
        """Kept when its time has come, by its own stamp; a late one is not caught up. `battery`: as
        `status` has it; None: it is not measured."""
        if snapshot.stamp_ns < self._due_ns:
            return
        self._due_ns = max(self._due_ns + self._period_ns, snapshot.stamp_ns)
        self.dropped += self._newest is not None
        self._newest = (snapshot, battery)
        self._filled.set()

    async def __aiter__(self) -> AsyncIterator[bytes]:
        """Each snapshot as one JSON object, without a line end."""
        while True:
            await self._filled.wait()
            self._filled.clear()
            newest, self._newest = self._newest, None
            if newest is not None:
                self.taken += 1
                snapshot, battery = newest
                yield encode(self._robot, snapshot, time.time_ns(), time.monotonic_ns(), battery)


def encode(
    robot: str,
    snapshot: Snapshot,
    wall_ns: int,
    now_ns: int,
    battery: Mapping[str, Any] | None = None,
) -> bytes:
    """The snapshot, its robot, and its own moment as wall time: inside, there is none."""
    stamp_s = (wall_ns - (now_ns - snapshot.stamp_ns)) / 1e9
    shown = {"robot": robot, "wall_time_s": stamp_s, **snapshot.to_json()}
    if battery is not None:
        shown["battery"] = battery
    return json.dumps(shown, allow_nan=False, separators=(",", ":")).encode()
