# SPDX-License-Identifier: Apache-2.0
"""The file in shared memory that holds the state page: whose it is, and when it goes.

Every user may make files in /dev/shm. So a file is mapped only if nobody else can write to it, or
make it shorter under the daemon (SIGBUS); what is not so is replaced by a new file.

Locks say that its daemon lives. The kernel takes them off whatever way a process dies, so a stale
file is told from a live one without trusting process numbers, which are given again. Who may only
read the file can lock it as well, but not with an open file description lock for writing
(fcntl(2)): that one counts.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import struct
import sys
from pathlib import Path
from typing import Self

FOLDER = Path("/dev/shm")  # noqa: S108  # POSIX shared memory, as shm_open has it
PREFIX = "motord-"
JOURNAL_PREFIX = "motord.journal-"
_PID_OFFSET, _PID_BYTES = 28, 4
_TRIES = 10
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_LOCK = struct.Struct("hhqqi4x")
"""struct flock: type, whence, start, length, pid."""


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

        Raises PageInUse where a daemon lives that owns it, or where it is another user's and cannot
        be replaced; ValueError for a name that is no file name, OSError where the file cannot be
        made (no /dev/shm).
        """
        if not name or "/" in name or "\0" in name:
            raise ValueError(f"{name!r} cannot be part of a file name in {FOLDER}")
        path = FOLDER / (prefix + name)
        for _ in range(_TRIES):
            fd = _open(path)
            if fd is None:
                _remove(path)
                continue
            with contextlib.ExitStack() as unless_kept:
                unless_kept.callback(os.close, fd)
                if not _lock(fd, path):
                    _remove(path)
                elif _is_still(path, fd):
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


def _open(path: Path) -> int | None:
    """The file, made if there is none. None: what is there is not ours alone."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        info = path.lstat()
    except FileNotFoundError:
        with contextlib.suppress(FileExistsError):
            return os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o600)  # no reader locks it first
        return None
    if not _is_ours(info):
        return None
    try:
        fd = os.open(path, flags)
    except OSError:  # it was replaced meanwhile, or may not be written
        return None
    if _is_ours(os.fstat(fd)):
        return fd
    os.close(fd)
    return None


def _is_ours(info: os.stat_result) -> bool:
    """A file by one name that only this user can write."""
    regular = stat.S_ISREG(info.st_mode) and info.st_nlink == 1
    return regular and info.st_uid == os.geteuid() and not info.st_mode & _OTHERS_WRITE


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise PageInUse(
            f"{path} belongs to another user, or others may write to it, and it cannot be replaced"
            f" ({error.strerror}): remove it as root, or give this robot another name"
        ) from None


def _lock(fd: int, path: Path) -> bool:
    """False: somebody who may only read it has locked it. Raises PageInUse."""
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0))
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        if not _is_locked_by_a_writer(fd):
            return False
    else:
        return True
    pid = int.from_bytes(os.pread(fd, _PID_BYTES, _PID_OFFSET), sys.byteorder)
    raise PageInUse(
        f"{path} is locked by a living daemon (process {pid}): stop it, or give this robot another"
        " name"
    )


def _is_locked_by_a_writer(fd: int) -> bool:
    """Another one than this descriptor."""
    wish = _LOCK.pack(fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0)
    kind, *_ = _LOCK.unpack(fcntl.fcntl(fd, fcntl.F_OFD_GETLK, wish))
    return bool(kind != fcntl.F_UNLCK)


def _is_still(path: Path, fd: int) -> bool:
    """Whether the name still leads to the file that was opened: its owner may have removed it."""
    try:
        there = path.stat(follow_symlinks=False)
    except FileNotFoundError:
        return False
    return os.path.samestat(there, os.fstat(fd))
