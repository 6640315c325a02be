# SPDX-License-Identifier: Apache-2.0
"""Reads the journal of a running daemon, and makes messages of it that a recording keeps:
docs/replay.md."""

from __future__ import annotations

import mmap
import os
import struct
from pathlib import Path
from typing import Self

import zstandard

from motord.api.page_file import JOURNAL, find_page, slots_fit
from motord.bus.messages.cdr import HEADER

TOPIC, TYPE_NAME = "core_journal", "motord_msgs/msg/CoreJournal"
_MAGIC = b"MOTORDJ\1"
_LAYOUT_VERSION = 12
_LAYOUT = struct.Struct("=8s10I")
"""Fields: magic; layout version; records: count, stride, offset, bytes; checkpoints: the same four;
the writer's process."""
_SO_FAR = struct.Struct("=2Q")
"""Behind the layout: records and checkpoints so far."""
_SEQUENCE = struct.Struct("=Q")
_MARGIN = 256
"""Number of records that the writer may add while the oldest ones are read."""
_CHECKPOINT_EVERY = 1024
"""Number of records after each checkpoint, which is the state before the first of them."""
_RECORDS_MAX = 2048
"""Largest number of records in one message; more records follow in the next."""
_FIXED = struct.Struct("<4I")


class NoJournal(Exception):
    """There is no journal to be read; the text is the reason."""


class Journal:
    """The journal of one robot, read from the oldest record that a checkpoint precedes."""

    def __init__(self, path: Path, file: os.stat_result, memory: mmap.mmap) -> None:
        """Raise NoJournal if the memory does not hold a journal of this layout."""
        self._path = path
        self._memory = memory
        self._inode = file.st_ino
        self._layout = memory[: _LAYOUT.size]
        fields = _LAYOUT.unpack(self._layout)
        magic, self._layout_version = fields[:2]
        self._count, self._stride, self._offset, self.record_bytes = fields[2:6]
        self._checkpoint_count, self._checkpoint_stride = fields[6:8]
        self._checkpoint_offset, self.checkpoint_bytes = fields[8:10]
        known = magic == _MAGIC and self._layout_version == _LAYOUT_VERSION
        if not known or not all(
            slots_fit(file.st_size, count, stride, offset, _SEQUENCE.size + size)
            for count, stride, offset, size in (fields[2:6], fields[6:10])
        ):
            raise NoJournal(
                f"{path} is not a journal of layout {_LAYOUT_VERSION}, or is being made"
            )
        self._records = 0
        self._checkpoints = 0
        self._lost = 0
        self._compressor = zstandard.ZstdCompressor(level=1)

    @classmethod
    def open(cls, robot: str) -> Self:
        """Open the journal of that robot. Raises NoJournal."""
        path = find_page(robot, JOURNAL)
        try:
            fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise NoJournal(f"{path}: {error.strerror}") from None
        try:
            file = os.fstat(fd)
            if file.st_size < _LAYOUT.size + _SO_FAR.size:
                raise NoJournal(f"{path} is being made")
            memory = mmap.mmap(fd, file.st_size, mmap.MAP_SHARED, mmap.PROT_READ)
        finally:
            os.close(fd)
        try:
            return cls(path, file, memory)
        except NoJournal:
            memory.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._memory.close()

    @property
    def gone(self) -> bool:
        """Whether the file was removed, or another daemon's is in its place."""
        try:
            same = self._path.stat().st_ino == self._inode
        except FileNotFoundError:
            return True
        return not same or self._memory[: _LAYOUT.size] != self._layout

    def take_lost(self) -> int:
        """Return how many records were overwritten before they were read, since the last call."""
        lost, self._lost = self._lost, 0
        return lost

    def message(self) -> bytes | None:
        """Return what is new, as a CoreJournal in CDR; None: nothing is new."""
        checkpoints, records = self._new_checkpoints(), self._new_records()
        if not checkpoints and not records:
            return None
        packed = [self._compressor.compress(part) for part in (checkpoints, records)]
        out = bytearray(HEADER)
        out += _FIXED.pack(
            self._layout_version, self.record_bytes, self.checkpoint_bytes, len(packed[0])
        )
        out += packed[0] + bytes(-len(packed[0]) % 4)
        out += struct.pack("<I", len(packed[1])) + packed[1]
        out += bytes(-len(out) % 4)
        return bytes(out)

    def _new_checkpoints(self) -> bytes:
        so_far = _SO_FAR.unpack_from(self._memory, _LAYOUT.size)[1]
        first = max(self._checkpoints, so_far - self._checkpoint_count)
        self._checkpoints = so_far
        return b"".join(
            found
            for number in range(first + 1, so_far + 1)
            if (found := self._checkpoint(number)) is not None
        )

    def _checkpoint(self, number: int) -> bytes | None:
        at = (number - 1) % self._checkpoint_count * self._checkpoint_stride
        return self._slot(self._checkpoint_offset + at, number, self.checkpoint_bytes)

    def _new_records(self) -> bytes:
        so_far = _SO_FAR.unpack_from(self._memory, _LAYOUT.size)[0]
        first = self._records
        oldest = so_far - self._count + _MARGIN
        if oldest > first:
            # Records before the next checkpoint are of no use: the one before them is gone.
            oldest += -oldest % _CHECKPOINT_EVERY
            self._lost += oldest - first if first > 0 else 0
            first = oldest
        self._records = last = min(so_far, first + _RECORDS_MAX)
        found = []
        for number in range(first + 1, last + 1):
            at = (number - 1) % self._count * self._stride
            record = self._slot(self._offset + at, number, self.record_bytes)
            if record is None:
                self._lost += 1
            else:
                found.append(record)
        return b"".join(found)

    def _slot(self, at: int, number: int, size: int) -> bytes | None:
        """Return the content of a slot; None: it has been overwritten."""
        start = at + _SEQUENCE.size
        before = _SEQUENCE.unpack_from(self._memory, at)[0]
        found = self._memory[start : start + size]
        after = _SEQUENCE.unpack_from(self._memory, at)[0]
        return found if before == after == 2 * number else None
