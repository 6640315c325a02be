# SPDX-License-Identifier: Apache-2.0
"""Where the log goes: stderr. Under systemd each line says its priority, as sd-daemon(3) has it,
and leaves the time to the journal."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Mapping

_PRIORITIES = (
    (logging.ERROR, "<3>"),
    (logging.WARNING, "<4>"),
    (logging.INFO, "<6>"),
    (logging.DEBUG, "<7>"),
)


class _JournalFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        mark = next((mark for level, mark in _PRIORITIES if record.levelno >= level), "<7>")
        return "\n".join(mark + line for line in super().format(record).splitlines())


def set_up(environ: Mapping[str, str] = os.environ) -> None:
    """Once, by the daemon's entry point."""
    handler = logging.StreamHandler(sys.stderr)
    if "JOURNAL_STREAM" in environ:
        handler.setFormatter(_JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
