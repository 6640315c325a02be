# SPDX-License-Identifier: Apache-2.0
"""Watches the machine while the loop runs, and collects the data for the search of causes."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from motord.realtime.loop import Loop
from motord.tools.latency.causes.activity import Counts, Threads, counts
from motord.tools.latency.causes.suspects import Case, Verdict
from motord.tools.latency.causes.switches import SwitchesUnknown, SwitchReader

LATE_FROM_NS = 50_000
"""Lateness from which a tick counts as late: it is then worse than the class "usable"."""
LOOP_THREAD = "motord-loop"


def late_from_ns(rate_hz: float) -> int:
    """Return the lateness from which a tick counts as late at a rate: LATE_FROM_NS, but at most
    half of a period."""
    return min(LATE_FROM_NS, round(0.5e9 / rate_hz))


class Watcher:
    """A context manager for a loop that runs with `late_from_ns`. Call `look` every tenth of a
    second, in the thread that owns the loop."""

    def __init__(self, loop: Loop, rate_hz: float) -> None:
        self._loop, self._threads = loop, Threads()
        status = loop.status()
        self._case = Case(
            own_thread(LOOP_THREAD), status.priority, late_from_ns(rate_hz) * 1e-3,
            self._threads.known,
        )  # fmt: skip
        self._reader: SwitchReader | None = None
        self._note = ""
        self._release = contextlib.ExitStack()
        self._before: Counts = {}
        self._began_s = self._looked_s = time.monotonic()

    def __enter__(self) -> Self:
        try:
            cpus = range(os.cpu_count() or 1)
            self._reader = self._release.enter_context(SwitchReader(cpus))
        except SwitchesUnknown as error:
            self._note = f"which threads had the CPUs is not known: {error}"
        self.begin()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._release.close()

    def begin(self) -> None:
        """Begin the first window now; what happened before does not count."""
        self._loop.take_late()
        self._before = counts()
        self._began_s = self._looked_s = time.monotonic()

    def look(self) -> None:
        """End a window now, and begin the next one."""
        now_s, found = time.monotonic(), counts()
        switches = self._reader.read(time.monotonic_ns()) if self._reader else None
        grown = {key: n - self._before.get(key, n) for key, n in found.items()}
        late = self._loop.take_late()
        holders = self._case.add(late, grown, now_s - self._looked_s, switches)
        for thread in holders | self._threads.known.keys():
            self._threads.look(thread)
        self._before, self._looked_s = found, now_s

    def verdict(self) -> Verdict:
        """Return the result for all windows so far."""
        switches = self._reader.switches if self._reader else None
        lost = self._loop.status().late_lost
        return self._case.verdict(self._looked_s - self._began_s, switches, lost, self._note)


def own_thread(name: str) -> int:
    """Return the number of this process's thread of that name; 0: there is no such thread."""
    for folder in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # the thread has just ended
            if (folder / "comm").read_text().strip() == name:
                return int(folder.name)
    return 0
