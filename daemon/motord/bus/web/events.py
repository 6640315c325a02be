# SPDX-License-Identifier: Apache-2.0
"""Events of the robot as sentences: from the daemon's log, from its status, and from the log of
this process."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from motord.bus.log_listener import LogListener
from motord.bus.messages.topics import View

KEPT_MAX = 500
Event = dict[str, Any]
_LEVELS = ((logging.ERROR, "error"), (logging.WARNING, "warning"))


class Events:
    """Collects events, and keeps the newest ones for pages that connect later."""

    def __init__(self, publish: Callable[[Event], None]) -> None:
        self._publish = publish
        self.log = LogListener(self._take)
        self.kept: deque[Event] = deque(maxlen=KEPT_MAX)
        self._number = 0
        self.log_number = 0
        """Number of the newest line of the daemon's log that was noted."""
        self._owner: str | None = None
        self._lines: Mapping[str, Any] = {}
        self._status_ns = 0

    def note(
        self, source: str, text: str, level: str = "info", wall_time_s: float | None = None
    ) -> None:
        """Add an event. `level`: info, warning or error. `wall_time_s`: now unless it is given."""
        self._number += 1
        event = {
            "number": self._number,
            "wall_time_s": time.time() if wall_time_s is None else wall_time_s,
            "level": level,
            "source": source,
            "text": text,
        }
        self.kept.append(event)
        self._publish(event)

    def look(self, view: View) -> None:
        """Note what has changed in the daemon's status."""
        if view.status is not None and view.status_ns != self._status_ns:
            self._status_ns = view.status_ns
            self._look_at_status(view)

    def note_log(self, answer: Mapping[str, Any]) -> None:
        """Note new lines of the daemon's log: the answer of its method `log` after `log_number`."""
        if answer["newest"] < self.log_number:  # another daemon
            self.log_number = 0
            return
        self.log_number = answer["newest"]
        for line in answer["records"]:
            level = line["level"] if line["level"] in ("info", "warning") else "error"
            self.note("motord", line["text"], level, line["time_s"])

    def _look_at_status(self, view: View) -> None:
        commander = view.commander()
        owner = None if commander is None else commander.owner
        if owner != self._owner:
            self._owner = owner
            self.note("command", "no source commands" if owner is None else f"{owner} commands")
        lines = (view.status or {}).get("lines", {})
        for name, line in lines.items():
            before = self._lines.get(name, {})
            if before:
                self._count_errors(name, line["errors"], before["errors"])
        self._lines = lines

    def _count_errors(self, name: str, now: Mapping[str, int], before: Mapping[str, int]) -> None:
        more = {kind: count - before.get(kind, 0) for kind, count in now.items()}
        text = ", ".join(f"{count} {kind}" for kind, count in more.items() if count > 0)
        if text:
            self.note(name, f"errors: {text}", "warning")

    def _take(self, record: logging.LogRecord) -> None:
        level = next((word for least, word in _LEVELS if record.levelno >= least), "info")
        self.note("motord-bus", record.getMessage(), level)
