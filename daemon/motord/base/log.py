# SPDX-License-Identifier: Apache-2.0
"""The log's destination: the journal, with fields to search by, if stderr is the journal's; else
stderr.

The reader of the log may stop reading, and then a write blocks. The robot does not wait for that: a
separate thread writes, and drops what does not fit into its queue.

Sources: systemd.exec(5), $JOURNAL_STREAM; systemd, docs/JOURNAL_NATIVE_PROTOCOL.md."""

from __future__ import annotations

import atexit
import errno
import logging
import os
import queue
import socket
import struct
import sys
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

JOURNAL = Path("/run/systemd/journal/socket")
_FIELDS = "motord_fields"
_PRIORITIES = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG = 7
_AS_ERROR = {"levelno": logging.ERROR, "levelname": "ERROR"}
_LINES_MAX = 1000
TEXT_CHARS_MAX = 300
"""Characters of a client's text that one line of the log shows."""
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EAGAIN, errno.EIO)
"""Errors of a full disk, or of a full pipe that does not block: it may have room again."""
_STACK_BYTES = 256 * 1024
"""Stack of the thread, which only writes; the loop's mlockall would pin all 8 MB of an ordinary
one."""
_LAST_WORDS_S = 0.5
"""Time at the end of the process to write what is still in the queue."""


def about(
    *, line: str = "", joints: Iterable[str] = (), event: str = "", faults: Iterable[str] = ()
) -> dict[str, object]:
    """Return `extra` of a log record: what the record is about. In the journal it becomes
    MOTORD_LINE, MOTORD_EVENT, and a MOTORD_JOINT or MOTORD_FAULT for each."""
    fields = [("MOTORD_LINE", line), ("MOTORD_EVENT", event)]
    fields += [("MOTORD_JOINT", joint) for joint in joints]
    fields += [("MOTORD_FAULT", fault) for fault in faults]
    return {_FIELDS: [(name, value) for name, value in fields if value]}


class _Writer(logging.Handler):
    """Handler that formats at once, and writes lines to stderr when it can."""

    def __init__(self, fd: int) -> None:
        super().__init__()
        self._fd = fd
        self._queue: queue.Queue[bytes | None] = queue.Queue(_LINES_MAX)
        self._lost = 0
        # a daemon thread: one that is stuck in its write does not keep the process running
        self._thread = threading.Thread(target=self._work, name="motord-log", daemon=True)
        before = threading.stack_size(_STACK_BYTES)
        self._thread.start()
        threading.stack_size(before)
        atexit.register(self._end)

    def encode(self, record: logging.LogRecord) -> bytes:
        return self.format(record).encode(errors="backslashreplace") + b"\n"

    def write(self, entry: bytes) -> None:
        """Write an entry; what finds no room now is lost. Raises OSError if it can never be
        read."""
        try:
            while entry:
                entry = entry[os.write(self._fd, entry) :]
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
            self._lost += 1

    def note(self, lost: int) -> bytes:
        return b"(%d lines of the log were lost before this one)\n" % lost

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._queue.put_nowait(self.encode(record))
        except queue.Full:
            self._lost += 1
        except (TypeError, ValueError) as error:  # the text and its values do not fit
            # not logging's handleError: that writes to stderr, here and now
            text = f"{record.pathname}:{record.lineno}: cannot be logged: {error}"
            self.emit(logging.makeLogRecord({"msg": "%s", "args": (text,), **_AS_ERROR}))

    def _work(self) -> None:
        while (entry := self._queue.get()) is not None:
            lost, self._lost = self._lost, 0
            try:
                if lost:
                    self.write(self.note(lost))
                self.write(entry)
            except OSError:
                return

    def _end(self) -> None:
        try:
            self._queue.put_nowait(None)
        except queue.Full:
            return
        self._thread.join(_LAST_WORDS_S)


class _JournalWriter(_Writer):
    """Handler that sends entries to the journal, one a datagram. While it is away, they are
    lost."""

    def __init__(self, fd: int, path: Path) -> None:
        self._path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        super().__init__(fd)

    def encode(self, record: logging.LogRecord) -> bytes:
        priority = next((p for level, p in _PRIORITIES if record.levelno >= level), _DEBUG)
        return _entry(self.format(record), priority, getattr(record, _FIELDS, ()))

    def write(self, entry: bytes) -> None:
        try:
            self._socket.sendto(entry, self._path)
        except OSError:  # it is being restarted, or the entry is too long for it
            self._lost += 1

    def note(self, lost: int) -> bytes:
        return _entry(f"{lost} lines of the log were lost before this one", 4, ())


def _entry(message: str, priority: int, fields: Iterable[tuple[str, str]]) -> bytes:
    named = (("MESSAGE", message), ("PRIORITY", str(priority)), ("SYSLOG_IDENTIFIER", "motord"))
    return b"".join(_field(name, value) for name, value in (*named, *fields))


def _field(name: str, value: str) -> bytes:
    """Return one field of an entry; a value of several lines comes with its length."""
    data = value.encode(errors="backslashreplace")
    if b"\n" not in data:
        return b"%s=%s\n" % (name.encode(), data)
    return b"%s\n%s%s\n" % (name.encode(), struct.pack("<Q", len(data)), data)


def _is_journal(fd: int, environ: Mapping[str, str]) -> bool:
    """Return whether stderr is the journal's. A child that has its stderr elsewhere inherits the
    variable, too: then device and inode differ."""
    info = os.fstat(fd)
    return environ.get("JOURNAL_STREAM") == f"{info.st_dev}:{info.st_ino}"


def set_up(environ: Mapping[str, str] = os.environ, journal: Path = JOURNAL) -> None:
    """Set up the log, once, in the daemon's entry point."""
    handler: logging.Handler
    if sys.stderr is None:  # closed by the parent process: its number may be another file's by now
        handler = logging.NullHandler()
    elif _is_journal(sys.stderr.fileno(), environ):
        handler = _JournalWriter(sys.stderr.fileno(), journal)
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = _Writer(sys.stderr.fileno())
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def process_name(pid: int) -> str:
    """Return the number of a process, and its name if it still runs, for use in a sentence."""
    try:
        name = Path(f"/proc/{pid}/comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return f"process {pid}"
    return f"process {pid}, {printable(name)}"


def printable(text: str) -> str:
    """Return a client's text, cut and without control characters, for one line of the log."""
    return "".join(one if one.isprintable() else "?" for one in text[:TEXT_CHARS_MAX])
