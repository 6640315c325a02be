# SPDX-License-Identifier: Apache-2.0
"""Runs recordings through the core again by `motord replay`, one at a time, in a process of the
lowest priority: this process must not load the core."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

from motord.bus.commands.gate import NotTaken
from motord.bus.web.processes.command import TaskOwner, answer

WITHIN_S = 1800.0
WAITING_MAX = 4
KEPT_MAX = 100
"""Largest number of outcomes that are kept; the oldest is dropped."""

Key = tuple[str, str]
"""Section and name of a recording."""


class Replays(TaskOwner):
    """Replays of recordings, and their outcomes."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self.found: dict[Key, dict[str, Any]] = {}
        """State of each recording's replay: {"state": "waits" or "runs"}, {"outcome": ...} or
        {"problem": why}."""
        self._changed = changed
        self._one = asyncio.Lock()
        self._running: dict[Key, asyncio.Task[dict[str, Any]]] = {}

    def start(self, key: Key, path: Path) -> None:
        """Start a replay. Raises NotTaken."""
        if self._tasks is None or key in self._running:
            raise NotTaken("this recording is being replayed already")
        if len(self._running) >= WAITING_MAX:
            raise NotTaken("too many recordings wait for a replay: try again")
        self._note(key, {"state": "waits"})
        task = self._running[key] = self._tasks.create_task(self._replay(key, path))
        # not in the task itself: one that is cancelled before its first step does nothing at all
        task.add_done_callback(lambda task: self._ended(key, task))

    def cancel(self, key: Key) -> None:
        """Cancel that replay, if it runs."""
        if (task := self._running.get(key)) is not None:
            task.cancel()

    async def _replay(self, key: Key, path: Path) -> dict[str, Any]:
        try:
            async with self._one:
                self._note(key, {"state": "runs"})
                return {"outcome": await answer("replay", str(path), within_s=WITHIN_S)}
        except NotTaken as error:
            return {"problem": str(error)}

    def _ended(self, key: Key, task: asyncio.Task[dict[str, Any]]) -> None:
        del self._running[key]
        failed = task.cancelled() or task.exception() is not None
        self._note(key, {} if failed else task.result())

    def _note(self, key: Key, found: dict[str, Any]) -> None:
        self.found.pop(key, None)
        if found:
            self.found[key] = found
        while len(self.found) > KEPT_MAX:
            del self.found[next(iter(self.found))]
        self._changed()
