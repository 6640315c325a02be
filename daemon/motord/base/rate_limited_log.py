# SPDX-License-Identifier: Apache-2.0
"""A log for events that other machines on the network can cause at any rate."""

from __future__ import annotations

import logging
import time

AGAIN_S = 10.0


class RateLimitedLog:
    """Log that writes the first of many equal messages, then one each `AGAIN_S` with their
    number."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._due_s = 0.0
        self._silent = 0

    def say(self, text: str) -> None:
        """Log a warning, unless one was logged within the last `AGAIN_S`."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            self._silent += 1
            return
        self._log.warning("%s%s", text, f" ({self._silent} more)" if self._silent else "")
        self._due_s, self._silent = now_s + AGAIN_S, 0


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
