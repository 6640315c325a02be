# SPDX-License-Identifier: Apache-2.0
"""A log for events that other machines on the network can cause at any rate."""

from __future__ import annotations

import logging
import time

AGAIN_S = 10.0
LINES_AT_ONCE = 5
"""Number of equal lines that `LimitedLines` writes within `AGAIN_S`."""


class RateLimitedLog:
    """Log that writes the first of many equal messages, then one each `AGAIN_S` with their
    number."""

    def __init__(
        self, log: logging.Logger, *, level: int = logging.WARNING, at_once: int = 1
    ) -> None:
        """`at_once`: number of messages that are written within `AGAIN_S`."""
        self._log, self._level = log, level
        self._at_once, self._written = at_once, 0
        self._due_s = 0.0
        self._silent = 0

    def say(self, text: str) -> None:
        """Log a message, unless `at_once` messages were logged within the last `AGAIN_S`."""
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s, self._written = now_s + AGAIN_S, 0
        if self._written == self._at_once:
            self._silent += 1
            return
        more = f" ({self._silent} more)" if self._silent else ""
        self._log.log(self._level, "%s%s", text, more)
        self._written += 1
        self._silent = 0


class LimitedLines:
    """Log of events that a client can cause at any rate, such as a stop of a robot at rest. Of each
    of the few texts there are, it writes `LINES_AT_ONCE` within `AGAIN_S`, and counts the rest."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._voices: dict[str, RateLimitedLog] = {}

    def say(self, text: str) -> None:
        """Log a line as information, unless it was logged too often."""
        if text not in self._voices:
            self._voices[text] = RateLimitedLog(
                self._log, level=logging.INFO, at_once=LINES_AT_ONCE
            )
        self._voices[text].say(text)


class RateLimitedFilter(logging.Filter):
    """Filter for the log of a library that writes a line for every message it drops: each kind of
    line is logged as RateLimitedLog does, in our own log. Exceptions pass."""

    def __init__(self, log: logging.Logger, where: str) -> None:
        """`log` is that of the library; the lines go to its parent."""
        super().__init__()
        self._log = log.parent or log
        self._where = where
        self._voices: dict[str, RateLimitedLog] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Implement `logging.Filter.filter`: True only for exceptions."""
        if record.exc_info:
            return True
        # one for each text without its numbers, of which a library has a few
        voice = self._voices.setdefault(str(record.msg), RateLimitedLog(self._log))
        voice.say(f"{self._where}: {record.getMessage()}")
        return False
