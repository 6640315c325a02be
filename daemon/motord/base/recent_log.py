# SPDX-License-Identifier: Apache-2.0
"""The last lines of the log, for programs that show them: `log` of the local socket."""

from __future__ import annotations

import logging
from collections import deque
from typing import Any

RECORDS_MAX = 200
TEXT_CHARS_MAX = 500


class RecentLog(logging.Handler):
    """Handler that keeps the newest records, up to RECORDS_MAX."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._records: deque[dict[str, Any]] = deque(maxlen=RECORDS_MAX)
        self._newest = 0

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = record.getMessage()
        except (TypeError, ValueError):  # the text and its values do not fit: the log reports it
            return
        text = text.encode(errors="backslashreplace").decode()[:TEXT_CHARS_MAX]
        self._newest += 1
        self._records.append(
            {
                "number": self._newest,
                "time_s": record.created,
                "level": record.levelname.lower(),
                "text": text,
            }
        )

    def after(self, number: int) -> dict[str, Any]:
        """Return records with greater numbers, the oldest first; `time_s` is the time of day
        (Unix). `newest` is smaller than `number` after a restart of the daemon."""
        found = [record for record in self._records if record["number"] > number]
        return {"newest": self._newest, "records": found}
