# SPDX-License-Identifier: Apache-2.0
"""Shows the exchanges of a line, live, by `motord trace`: a process runs as long as a page shows
that line, one for all pages that do."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motord.api.deadline import within
from motord.bus.commands.gate import NotTaken
from motord.bus.web.processes.command import TaskOwner, reason, running
from motord.bus.web.viewer import Viewer
from motord_hal.base.tasks import TaskGroup

SEND_EVERY_S = 0.2
END_WITHIN_S = 5.0
ROWS_MAX = 40
"""Largest number of rows in one message: a person reads no more."""
KEPT_MAX = 2000
"""Largest number of rows that are kept between two messages."""
USUAL = frozenset(("ok", "in", "out", "broadcast", "part of a frame"))
"""Results that are no failure: motord.tools.trace.exchanges.Words. Rows with any other result have
`failed` true."""

Row = dict[str, Any]


@dataclass(eq=False)
class _Look:
    """The trace of one line, and the pages that show it."""

    line: str
    viewers: set[Viewer] = field(default_factory=set)
    rows: deque[Row] = field(default_factory=lambda: deque(maxlen=KEPT_MAX))
    seen: int = 0
    problem: str = ""
    task: asyncio.Task[None] | None = None


class Traces(TaskOwner):
    """The traces of all lines."""

    def __init__(self, local_socket: Path) -> None:
        self._place = ("--socket", str(local_socket))
        self._looks: dict[str, _Look] = {}

    def show(self, viewer: Viewer, line: str) -> None:
        """Show a page the exchanges of a line from now on, instead of those that it was shown
        before."""
        self.leave(viewer)
        if self._tasks is None:
            return
        look = self._looks.get(line)
        if look is None:
            look = self._looks[line] = _Look(line)
            look.task = self._tasks.create_task(self._follow(look))
        look.viewers.add(viewer)

    def leave(self, viewer: Viewer) -> None:
        """Stop showing exchanges to a page."""
        for line, look in tuple(self._looks.items()):
            look.viewers.discard(viewer)
            if not look.viewers:
                del self._looks[line]
                if look.task is not None:
                    look.task.cancel()

    async def _follow(self, look: _Look) -> None:
        """Follow a line until no page shows it, or the command ends though pages show the line: the
        daemon is gone, the line has nothing to trace, or no process can be started."""
        try:
            problem = await self._run(look)
        except NotTaken as error:
            problem = str(error)
        text = json.dumps({"trace": {"line": look.line, "problem": problem}})
        for viewer in look.viewers:
            viewer.say(text)
        if self._looks.get(look.line) is look:
            del self._looks[look.line]

    async def _run(self, look: _Look) -> str:
        """Run the command, and return why it has ended. Raises NotTaken."""
        async with running("trace", look.line, "--json", *self._place) as child:
            async with TaskGroup() as tasks:
                errors: deque[bytes] = deque(maxlen=1)
                tasks.create_task(_read(child.stderr, errors.append))
                sending = tasks.create_task(self._send(look))
                await _read(child.stdout, lambda raw: self._take(look, raw))
                sending.cancel()
            with contextlib.suppress(TimeoutError):  # it is killed then
                async with within(END_WITHIN_S):
                    await child.wait()
        return look.problem or reason(b"".join(errors), "trace")

    def _take(self, look: _Look, raw: bytes) -> None:
        if not raw.endswith(b"\n"):  # it was killed in the middle of a line
            return
        row = json.loads(raw)
        if "result" not in row:  # the reason why the command ends
            look.problem = row.get("error", "")
            return
        look.seen += 1
        look.rows.append(row | {"failed": row["result"] not in USUAL})

    async def _send(self, look: _Look) -> None:
        while True:
            await asyncio.sleep(SEND_EVERY_S)
            if not look.seen:
                continue
            rows = chosen(look.rows)
            message = {"line": look.line, "rows": rows, "skipped": look.seen - len(rows)}
            look.rows.clear()
            look.seen = 0
            text = json.dumps({"trace": message})
            for viewer in look.viewers:
                if viewer.keeps_up:
                    viewer.say(text)


def chosen(rows: deque[Row]) -> list[Row]:
    """Return at most ROWS_MAX rows in their order. Failures are chosen first, then the newest of
    the others."""
    failed = [place for place, row in enumerate(rows) if row["failed"]]
    others = [place for place, row in enumerate(rows) if not row["failed"]]
    room = ROWS_MAX - len(failed[-ROWS_MAX:])
    places = {*failed[-ROWS_MAX:], *others[len(others) - min(room, len(others)) :]}
    return [row for place, row in enumerate(rows) if place in places]


async def _read(stream: asyncio.StreamReader | None, take: Callable[[bytes], None]) -> None:
    """Read a stream line by line, to its end."""
    assert stream is not None  # it is a pipe
    async for line in stream:
        take(line)
