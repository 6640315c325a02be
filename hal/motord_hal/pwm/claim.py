# SPDX-License-Identifier: Apache-2.0
"""Lock that gives a channel one owner: two programs that write the same pin would undo each other's
commands.

Sources: flock(2): the kernel releases the lock when the owner ends, by any cause; proc_locks(5).
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

PROC = Path("/proc")


class Taken(OSError):
    """A running program holds the channel. The text names the program if that can be read."""


def claim(fd: int, proc: Path = PROC) -> None:
    """Lock the channel until this descriptor is closed. Raises Taken, OSError."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        owner = owner_of(fd, proc) or "another program"
        raise Taken(f"{owner} drives it: end that first") from error


def owner_of(fd: int, proc: Path = PROC) -> str:
    """Return the program that has locked this file, as "program (pid N)"; "": that cannot be
    read."""
    status = os.fstat(fd)
    device = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    try:
        for row in (proc / "locks").read_text().splitlines():
            _, kind, *_, pid, place, _, _ = row.split()
            if kind == "FLOCK" and place == device:
                return f"{(proc / pid / 'comm').read_text().strip()} (pid {pid})"
    except OSError:
        return ""  # hidden from this user, or it has just ended
    return ""
