# SPDX-License-Identifier: Apache-2.0
"""Reads the kernel's records of context switches, forks and thread names on all processors
(perf_event_open(2)). They show which thread had a processor when, and which process started which.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import mmap
import os
import platform
import struct
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Self

# include/uapi/linux/perf_event.h
_TYPE_SOFTWARE, _COUNT_SW_DUMMY = 1, 9
_SAMPLE_TID_TIME_CPU = 1 << 1 | 1 << 2 | 1 << 7
_FLAGS = 1 << 9 | 1 << 13 | 1 << 18 | 1 << 25 | 1 << 26
"""Flags comm, task, sample_id_all, use_clockid and context_switch."""
_RECORD_LOST, _RECORD_COMM, _RECORD_FORK, _RECORD_SWITCH_CPU_WIDE = 2, 3, 7, 15
_MISC_SWITCH_OUT = 1 << 13
_FLAG_FD_CLOEXEC = 1 << 3
_CLOCK_MONOTONIC = 1
_ATTRIBUTES = struct.Struct("=IIQQQQQIIQQQQIiQII")
_HEADER = struct.Struct("=IHH")
_SAMPLE_ID = struct.Struct("=IIQII")
_DATA_HEAD = 1024
"""Offset of data_head in the first page; data_tail, data_offset and data_size follow, u64 each."""
_SYSCALLS = {"x86_64": 298, "aarch64": 241, "armv7l": 364, "riscv64": 241}
DATA_BYTES = 1 << 20
KEPT_NS = 2_000_000_000


class SwitchesUnknown(Exception):
    """The kernel gives no records; the message contains the reason and, if known, what to do."""


@dataclass(slots=True)
class Switches:
    """The records so far. `on`: CPU → (begin in ns, thread), in order; `parent`: process → its
    parent; `name`: thread → name; `forks`: process → number of processes that it has started,
    without its threads; `lost`: number of lost records."""

    on: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    parent: dict[int, int] = field(default_factory=dict)
    name: dict[int, str] = field(default_factory=dict)
    forks: dict[int, int] = field(default_factory=dict)
    lost: int = 0

    def held(self, cpu: int, begin_ns: int, end_ns: int) -> dict[int, int]:
        """Return thread → time in ns that it had this processor between the two times. Thread 0
        means that the processor was idle."""
        shares: dict[int, int] = {}
        rows = self.on.get(cpu, [])
        untils = [*(row[0] for row in rows[1:]), end_ns]
        for (since_ns, thread), until_ns in zip(rows, untils, strict=False):
            span_ns = min(until_ns, end_ns) - max(since_ns, begin_ns)
            if span_ns > 0:
                shares[thread] = shares.get(thread, 0) + span_ns
        return shares

    def forget(self, before_ns: int) -> None:
        """Delete the switches before a time, except the last one of each processor."""
        for cpu, rows in self.on.items():
            kept = next((i for i, row in enumerate(rows) if row[0] > before_ns), len(rows))
            self.on[cpu] = rows[max(kept - 1, 0) :]

    def read(self, *processors: bytes) -> None:
        """Add the records of all processors together, in the order of their times, because a
        process often starts on one processor and gets its name on another."""
        records = [one for processor in processors for one in _records(processor)]
        for kind, misc, body in sorted(records, key=_time_ns):
            self._add(kind, misc, body)

    def _add(self, kind: int, misc: int, body: bytes) -> None:
        if kind == _RECORD_LOST:
            self.lost += struct.unpack_from("=Q", body, 8)[0]
            return
        _, thread, time_ns, cpu, _ = _SAMPLE_ID.unpack_from(body, len(body) - _SAMPLE_ID.size)
        if kind == _RECORD_SWITCH_CPU_WIDE and not misc & _MISC_SWITCH_OUT:
            self.on.setdefault(cpu, []).append((time_ns, thread))
        elif kind == _RECORD_FORK:
            process, parent, child_thread, _ = struct.unpack_from("=IIII", body)
            self.name[child_thread] = self.name.get(parent, "")
            if process != parent:
                self.parent[process] = parent
                self.forks[parent] = self.forks.get(parent, 0) + 1
        elif kind == _RECORD_COMM:
            named = struct.unpack_from("=II", body)[1]
            self.name[named] = body[8 : -_SAMPLE_ID.size].split(b"\0")[0].decode(errors="replace")


def _records(processor: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield kind, flags and body of each complete record."""
    at = 0
    while at + _HEADER.size <= len(processor):
        kind, misc, size = _HEADER.unpack_from(processor, at)
        if size < _HEADER.size:
            return
        body = processor[at + _HEADER.size : at + size]
        if len(body) >= _SAMPLE_ID.size:
            yield kind, misc, body
        at += size


def _time_ns(record: tuple[int, int, bytes]) -> int:
    body = record[2]
    return int(_SAMPLE_ID.unpack_from(body, len(body) - _SAMPLE_ID.size)[2])


class SwitchReader:
    """Reads the records of some processors, from its start on. A context manager."""

    def __init__(self, cpus: Iterable[int]) -> None:
        """Start recording. Raise SwitchesUnknown if the kernel gives no records."""
        self.switches = Switches()
        self._release = contextlib.ExitStack()
        with contextlib.ExitStack() as unless_opened:
            self._rings = [unless_opened.enter_context(_ring(cpu)) for cpu in cpus]
            self._release = unless_opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._release.close()

    def read(self, now_ns: int) -> Switches:
        """Add the new records; return all that are not older than KEPT_NS."""
        self.switches.read(*map(_taken, self._rings))
        self.switches.forget(now_ns - KEPT_NS)
        return self.switches


@contextlib.contextmanager
def _ring(cpu: int) -> Iterator[mmap.mmap]:
    number = _SYSCALLS.get(platform.machine())
    if number is None or sys.byteorder != "little":
        raise SwitchesUnknown(f"not on {platform.machine()}")
    libc = ctypes.CDLL(None, use_errno=True)
    attributes = ctypes.create_string_buffer(
        _ATTRIBUTES.pack(
            _TYPE_SOFTWARE, _ATTRIBUTES.size, _COUNT_SW_DUMMY, 0, _SAMPLE_TID_TIME_CPU, 0, _FLAGS,
            0, 0, 0, 0, 0, 0, 0, _CLOCK_MONOTONIC, 0, 0, 0,
        ),
        _ATTRIBUTES.size,
    )  # fmt: skip
    fd = libc.syscall(number, attributes, -1, cpu, -1, ctypes.c_ulong(_FLAG_FD_CLOEXEC))
    if fd < 0:
        code = ctypes.get_errno()
        how = ": run it as root" if code in (errno.EACCES, errno.EPERM) else ""
        raise SwitchesUnknown(f"perf_event_open: {os.strerror(code)}{how}")
    try:
        ring = mmap.mmap(fd, mmap.PAGESIZE + DATA_BYTES)
    except OSError as error:
        raise SwitchesUnknown(f"perf_event_open: {error.strerror}: run it as root") from error
    finally:
        os.close(fd)
    with ring:
        yield ring


def _taken(ring: mmap.mmap) -> bytes:
    """Take the bytes between tail and head. The head is read before the data, and the tail is
    written after it; x86 keeps this order, and on ARM the calls between are barriers."""
    head, tail, offset, size = struct.unpack_from("=QQQQ", ring, _DATA_HEAD)
    begin, end = tail % size, head % size
    data = ring[offset : offset + size]
    found = data[begin:end] if begin <= end else data[begin:] + data[:end]
    struct.pack_into("=Q", ring, _DATA_HEAD + 8, head)
    return found
