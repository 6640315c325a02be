# SPDX-License-Identifier: Apache-2.0
"""A voice for what others on the network can cause at any rate."""

from __future__ import annotations

import logging
import time

AGAIN_S = 10.0


class Sparing:
    """The first of one matter, and then one of many each `AGAIN_S` with how many there were."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._due_s = 0.0
        self._silent = 0

    def say(self, text: str) -> None:
        """A warning."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            self._silent += 1
            return
        self._log.warning("%s%s", text, f" ({self._silent} more)" if self._silent else "")
        self._due_s, self._silent = now_s + AGAIN_S, 0
