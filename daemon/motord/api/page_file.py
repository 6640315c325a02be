# SPDX-License-Identifier: Apache-2.0
"""The file in shared memory that holds the state page: its path, its owner, and its removal.

Every user can create files in /dev/shm. So the daemon keeps its files in a folder of its own,
/dev/shm/motord-UID, in which no other user can create, truncate or replace them (SIGBUS). If
another user has created that name first, the daemon makes a folder with a random ending.

A lock shows that the daemon lives. The kernel releases it however the process ends, so it separates
a stale file from a live one; process numbers would not, for they are reused. A user who may only
read the file can lock it as well, but not with an open file description lock for writing
(fcntl(2)), so only that kind of lock counts."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import struct
import sys
import tempfile
from pathlib import Path
from typing import Self

SHARED = Path("/dev/shm")  # noqa: S108  # POSIX shared memory, as shm_open has it
PAGE, JOURNAL = ".page", ".journal"
SERVICE_FOLDER = Path("/run/motord")
"""Folder of the service; its owner is the user that the service runs as."""
_PID_OFFSET, _PID_BYTES = 28, 4
_HEADER_BYTES, _WORD_BYTES = 64, 8
_LOCKS = Path("/proc/locks")
_TRIES = 10
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_LOCK = struct.Struct("hhqqi4x")
"""struct flock: type, whence, start, length, pid."""


class PageInUse(RuntimeError):
    """Another daemon writes the page of that name."""


def folders_of(uid: int) -> list[Path]:
    """The folders in shared memory that only this user can write to."""
    named = [SHARED / f"motord-{uid}", *sorted(SHARED.glob(f"motord-{uid}-*"))]
    return [path for path in named if _is_private(path, uid)]


def find_page(name: str, suffix: str = PAGE, owner: int | None = None) -> Path:
    """The state page of the robot `name`, or its journal. `owner`: the user id of its daemon. By
    default this user's own daemon, the service and root's daemon are tried in this order. If there
    is no such file, returns where this user's daemon would create it."""
    owners = [owner] if owner is not None else [os.geteuid(), *_service_user(), 0]
    found = [folder / (name + suffix) for uid in owners for folder in folders_of(uid)]
    there = [path for path in found if path.exists()]
    living = [path for path in there if writer_lives(path)]
    return next(iter(living or there), SHARED / f"motord-{owners[0]}" / (name + suffix))


def _service_user() -> list[int]:
    try:
        return [SERVICE_FOLDER.lstat().st_uid]
    except FileNotFoundError:
        return []


def writer_lives(path: Path) -> bool:
    """Return whether a daemon that lives has locked the page."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        return _is_locked_by_a_writer(fd)
    finally:
        os.close(fd)


def writer_pid(path: Path) -> int | None:
    """Return the process that has locked the page, as the kernel knows it: the number in the page
    outlives its process. None: nothing is locked, or /proc does not show the process here."""
    try:
        file = path.stat(follow_symlinks=False)
        locks = _LOCKS.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeError):
        return None
    place = f"{os.major(file.st_dev):02x}:{os.minor(file.st_dev):02x}:{file.st_ino}"
    for lock in locks:
        _, kind, _, access, pid, where, *_ = lock.split()
        if (kind, access, where) == ("FLOCK", "WRITE", place) and int(pid) > 0:
            return int(pid)
    return None


def _is_private(path: Path, uid: int) -> bool:
    try:
        info = path.lstat()
    except FileNotFoundError:
        return False
    return stat.S_ISDIR(info.st_mode) and info.st_uid == uid and not info.st_mode & _OTHERS_WRITE


def _own_folder() -> Path:
    """Return this user's folder; make it if it is missing. Raises OSError."""
    uid = os.geteuid()
    plain = SHARED / f"motord-{uid}"
    with contextlib.suppress(FileExistsError):
        plain.mkdir(0o700)
    found = folders_of(uid)
    folder = found[0] if found else Path(tempfile.mkdtemp(prefix=f"motord-{uid}-", dir=SHARED))
    folder.chmod(0o755)  # whatever the umask: readers are other users
    return folder


def own_page(name: str) -> Path:
    """Return where this user's daemon keeps the state page of the robot `name`. Raises OSError."""
    return _own_folder() / (name + PAGE)


def slots_fit(file_bytes: int, count: int, stride: int, offset: int, slot_bytes: int) -> bool:
    """Return whether the slots that a header describes (all but `count` in bytes) lie inside the
    file, at words of 64 bits, and do not overlap. A reader uses no number of a header before
    this."""
    aligned = stride % _WORD_BYTES == 0 and offset % _WORD_BYTES == 0
    apart = count >= 1 and stride >= slot_bytes
    return aligned and apart and offset >= _HEADER_BYTES and offset + count * stride <= file_bytes


class PageFile:
    """A robot's state page, or the journal beside it, which this process owns from `open` to
    `close`; all users can read it."""

    def __init__(self, path: Path, fd: int) -> None:
        self.path = path
        self.fd = fd

    @classmethod
    def open(cls, name: str, suffix: str = PAGE) -> Self:
        """Create the file, or take over that of a dead daemon; its readers stay attached.

        Raises PageInUse if another daemon owns it, ValueError for a name that is no file name, and
        OSError if the file cannot be made (no /dev/shm)."""
        if not name or "/" in name or "\0" in name:
            raise ValueError(f"{name!r} cannot be part of a file name in {SHARED}")
        for _ in range(_TRIES):
            path = _own_folder() / (name + suffix)
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
        raise PageInUse(f"other processes create and remove {path}: is one daemon started twice?")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the file, if it is still ours, and release it."""
        if self.fd < 0:
            return
        if _is_still(self.path, self.fd):
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()
            with contextlib.suppress(OSError):  # the folder still holds another robot's page
                self.path.parent.rmdir()
        os.close(self.fd)
        self.fd = -1


def _open(path: Path) -> int | None:
    """Open the file; create it if it is missing. None: another user may write the existing file."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        info = path.lstat()
    except FileNotFoundError:
        with contextlib.suppress(FileExistsError, FileNotFoundError):  # the folder may be removed
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
    """Return whether it is a regular file with one link that only this user can write."""
    regular = stat.S_ISREG(info.st_mode) and info.st_nlink == 1
    return regular and info.st_uid == os.geteuid() and not info.st_mode & _OTHERS_WRITE


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise PageInUse(
            f"{path} is not a file of this user alone and cannot be replaced ({error.strerror}): "
            "remove it"
        ) from None


def _lock(fd: int, path: Path) -> bool:
    """Lock the file. False: a user that may only read it has locked it. Raises PageInUse."""
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
    """Return whether a process has locked the file for writing through another descriptor."""
    wanted = _LOCK.pack(fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0)
    kind, *_ = _LOCK.unpack(fcntl.fcntl(fd, fcntl.F_OFD_GETLK, wanted))
    return bool(kind != fcntl.F_UNLCK)


def _is_still(path: Path, fd: int) -> bool:
    """Whether the name still leads to the file that was opened: its owner may have removed it."""
    try:
        there = path.stat(follow_symlinks=False)
    except FileNotFoundError:
        return False
    return os.path.samestat(there, os.fstat(fd))
