# SPDX-License-Identifier: Apache-2.0
"""Where the log goes: stderr. Under systemd each line says its priority, as sd-daemon(3) has it,
and leaves the time to the journal.

Who reads it may stop reading, and then a write blocks. The robot does not wait for that: a thread
of its own writes, and what does not find room in its queue is lost.
"""

from __future__ import annotations

import atexit
import logging
import os
import queue
import sys
import threading
from collections.abc import Mapping

_PRIORITIES = (
    (logging.ERROR, "<3>"),
    (logging.WARNING, "<4>"),
    (logging.INFO, "<6>"),
    (logging.DEBUG, "<7>"),
)
_LINES_MAX = 1000
_LAST_WORDS_S = 0.5
"""At the end, for what is still in the queue."""


class _JournalFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        mark = next((mark for level, mark in _PRIORITIES if record.levelno >= level), "<7>")
        return "\n".join(mark + line for line in super().format(record).splitlines())


class _Writer(logging.Handler):
    """Formats at once, writes when it can."""

    def __init__(self, fd: int) -> None:
        super().__init__()
        self._fd = fd
        self._lines: queue.Queue[bytes | None] = queue.Queue(_LINES_MAX)
        self._lost = 0
        # a daemon thread: one that is stuck in its write does not keep the process
        self._thread = threading.Thread(target=self._write, name="motord-log", daemon=True)
        self._thread.start()
        atexit.register(self._end)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._lines.put_nowait(self.format(record).encode(errors="backslashreplace") + b"\n")
        except queue.Full:
            self._lost += 1
        except (TypeError, ValueError):  # words and values that do not fit: never the robot's end
            self.handleError(record)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            lost, self._lost = self._lost, 0
            note = b"(%d lines of the log were lost before this one)\n" % lost if lost else b""
            try:
                _write_all(self._fd, note + line)
            except OSError:  # nobody can ever read it
                return

    def _end(self) -> None:
        try:
            self._lines.put_nowait(None)
        except queue.Full:
            return
        self._thread.join(_LAST_WORDS_S)


def _write_all(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data) :]


def set_up(environ: Mapping[str, str] = os.environ) -> None:
    """Once, by the daemon's entry point."""
    if sys.stderr is None:  # closed by who started us: its number may be another file's by now
        logging.basicConfig(level=logging.INFO, handlers=[logging.NullHandler()], force=True)
        return
    handler = _Writer(sys.stderr.fileno())
    if "JOURNAL_STREAM" in environ:
        handler.setFormatter(_JournalFormatter("%(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
