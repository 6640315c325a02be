# SPDX-License-Identifier: Apache-2.0
"""Publishes JSON lines on standard output.

The reader may stop reading: then a write blocks, perhaps for ever. So a thread of its own writes,
and snapshots are lost while it is blocked. (The descriptor is shared: making it non-blocking would
change it for the shell and other programs, too.)
"""

from __future__ import annotations

import logging
import os
import queue
import sys
import threading

from motord.bus.publish.snapshot_feed import SnapshotFeed
from motord.config import Publish

_log = logging.getLogger(__name__)


class StdoutPublisher:
    def __init__(self, name: str, _: Publish) -> None:
        self._name = name
        self._output = sys.stdout
        self._lines: queue.Queue[bytes | None] = queue.Queue(maxsize=1)
        self._broken = threading.Event()
        self.dropped = 0
        """Snapshots that were lost because the reader of standard output was slow."""

    async def run(self, feed: SnapshotFeed) -> None:
        """Implement `Publisher.run`. End when standard output is closed."""
        if (
            self._output is None
        ):  # closed by the parent process: its number may be another file's by now
            _log.warning("publish.%s: there is no standard output", self._name)
            return
        arguments = (self._output.fileno(),)
        # a daemon thread: one that is blocked in its write does not keep the process alive
        threading.Thread(target=self._write, args=arguments, daemon=True).start()
        try:
            async for line in feed:
                if self._broken.is_set():
                    _log.warning("publish.%s: standard output was closed", self._name)
                    return
                self._hand_over(line + b"\n")
        finally:
            self._hand_over(None)

    def _hand_over(self, line: bytes | None) -> None:
        """Give a line to the thread, in place of one that still waits."""
        while True:
            try:
                self._lines.put_nowait(line)
            except queue.Full:
                self._discard()
            else:
                return

    def _discard(self) -> None:
        try:
            self._lines.get_nowait()
        except queue.Empty:
            return
        self.dropped += 1

    def _write(self, fd: int) -> None:
        while (line := self._lines.get()) is not None:
            try:
                while line:
                    line = line[os.write(fd, line) :]
            except OSError:
                self._broken.set()
                return
