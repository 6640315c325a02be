# SPDX-License-Identifier: Apache-2.0
"""The file in shared memory that holds the state page: whose it is, and when it goes.

A lock on the file says that its daemon lives. The kernel takes it off whatever way a process dies,
so a stale file is told from a live one without trusting process numbers, which are given again.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import sys
from pathlib import Path
from typing import Self

FOLDER = Path("/dev/shm")  # noqa: S108  # POSIX shared memory, as shm_open has it
PREFIX = "motord-"
JOURNAL_PREFIX = "motord.journal-"
_PID_OFFSET, _PID_BYTES = 28, 4
_TRIES = 10


class PageInUse(RuntimeError):
    """Another daemon writes the page of that name."""


class PageFile:
    """Owner of /dev/shm/motord-NAME, or of the journal beside it, readable by all, from `open` to
    `close`."""

    def __init__(self, path: Path, fd: int) -> None:
        self.path = path
        self.fd = fd

    @classmethod
    def open(cls, name: str, prefix: str = PREFIX) -> Self:
        """Make the file, or take over that of a dead daemon; its readers stay attached.

        Raises PageInUse where a daemon lives that owns it, ValueError for a name that is no file
        name, OSError where the file cannot be made (no /dev/shm).
        """
        if not name or "/" in name or "\0" in name:
            raise ValueError(f"{name!r} cannot be part of a file name in {FOLDER}")
        path = FOLDER / (prefix + name)
        for _ in range(_TRIES):
            fd = _open(path)
            with contextlib.ExitStack() as unless_kept:
                unless_kept.callback(os.close, fd)
                _lock(fd, path)
                if _is_still(path, fd):
                    os.fchmod(fd, 0o644)  # whatever the umask: readers are other users
                    unless_kept.pop_all()
                    return cls(path, fd)
        raise PageInUse(f"{path} is made and removed again by others: is one daemon started twice?")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the file, if it is still ours, and let go of it."""
        if self.fd < 0:
            return
        if _is_still(self.path, self.fd):
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()
        os.close(self.fd)
        self.fd = -1


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    except PermissionError:
        raise PageInUse(
            f"{path} belongs to another user, whose daemon runs or was killed: give this robot"
            " another name, or remove the file when that daemon is gone"
        ) from None


def _lock(fd: int, path: Path) -> None:
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        pid = int.from_bytes(os.pread(fd, _PID_BYTES, _PID_OFFSET), sys.byteorder)
        raise PageInUse(
            f"{path} is locked by a living daemon (process {pid}): stop it, or give this robot"
            " another name"
        ) from None


def _is_still(path: Path, fd: int) -> bool:
    """Whether the name still leads to the file that was opened: its owner may have removed it."""
    try:
        there = path.stat(follow_symlinks=False)
    except FileNotFoundError:
        return False
    return os.path.samestat(there, os.fstat(fd))
