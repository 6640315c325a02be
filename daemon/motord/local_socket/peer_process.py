# SPDX-License-Identifier: Apache-2.0
"""The process at the other end of a connection, and when it was started (proc_pid_stat(5))."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

_TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")
_AFTER_NAME = 19
"""Place of `starttime` behind the name, which may contain spaces and parentheses."""


@dataclass(frozen=True, slots=True)
class Process:
    """A process. Its number alone may be given again; with its start it is unique."""

    pid: int
    started_ns: int
    """CLOCK_BOOTTIME, rounded down to a tick of the kernel."""

    def started_after(self, monotonic_ns: int) -> bool:
        """Return whether it was started after this time of CLOCK_MONOTONIC. A suspend of the
        computer since then makes the answer False for longer, never True too early."""
        ahead_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()
        return self.started_ns > monotonic_ns + ahead_ns

    @property
    def lives(self) -> bool:
        """Whether it has not ended."""
        return process_of(self.pid) == self


def process_of(pid: int) -> Process | None:
    """Return the process with this number; None: there is no such process here, or /proc does not
    show it, as for a process of another container."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
        ticks = int(stat[stat.rindex(b")") + 1 :].split()[_AFTER_NAME])
    except (OSError, ValueError, IndexError):
        return None
    return Process(pid, ticks * 1_000_000_000 // _TICKS_A_SECOND)
