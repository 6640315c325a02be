# SPDX-License-Identifier: Apache-2.0
"""Reads from files what the kernel counts while the loop is measured: interrupts, stolen time and
frequency changes of each processor, and the data of threads. It changes no setting."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

Counts: TypeAlias = dict[tuple[str, int, str], int]
"""(Kind, processor, name) → count."""
KERNEL_THREADS_PARENT = 2
"""Process number of kthreadd, which starts all threads of the kernel."""


def counts(root: Path = Path("/")) -> Counts:
    """Read counters that only grow. The kinds are `interrupt` and `softirq` (number of them),
    `steal` (clock ticks) and `frequency` (number of changes)."""
    found: Counts = {}
    for kind, file in (("interrupt", "interrupts"), ("softirq", "softirqs")):
        found |= _table(kind, _text(root / "proc" / file))
    for row in _text(root / "proc/stat").splitlines():
        name, *fields = row.split()
        if name.startswith("cpu") and name != "cpu" and len(fields) > 7:
            found["steal", int(name[3:]), ""] = int(fields[7])
    for path in (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/stats/total_trans"):
        text = _text(path).strip()
        if text.isdigit():
            found["frequency", int(path.parts[-4][3:]), ""] = int(text)
    return found


def _table(kind: str, text: str) -> Counts:
    """Parse /proc/interrupts or /proc/softirqs: a column for each processor, then a description."""
    head, *rows = text.splitlines() or [""]
    cpus = [int(word[3:]) for word in head.split()]
    found: Counts = {}
    for row in rows:
        name, _, rest = row.partition(":")
        words = rest.split()
        numbers = words[: len(cpus)]
        about = " ".join(words[len(cpus) :])
        for cpu, number in zip(cpus, numbers, strict=False):
            if number.isdigit():
                found[kind, cpu, f"{name.strip()} {about}".strip()] = int(number)
    return found


@dataclass(slots=True)
class Thread:
    """A thread that had a processor, with its data at the first and the last look."""

    thread: int
    process: int
    name: str
    policy: str
    priority: int
    of_kernel: bool
    first: tuple[float, int] = (0.0, 0)
    """Time of the first look in s, and the number of page faults until then."""
    last: tuple[float, int] = (0.0, 0)

    @property
    def faults_per_s(self) -> float:
        """Page faults a second between the two looks; 0 before the second look."""
        spent_s = self.last[0] - self.first[0]
        return (self.last[1] - self.first[1]) / spent_s if spent_s > 0 else 0.0


@dataclass(slots=True)
class Threads:
    """Number → thread, for the threads that were looked at. A thread that ended before its first
    look stays unknown."""

    root: Path = Path("/")
    known: dict[int, Thread] = field(default_factory=dict)

    def look(self, thread: int) -> Thread | None:
        """Read the data of a thread now. Return what is known of it; None: nothing."""
        folder = self.root / f"proc/{thread}"
        status = _text(folder / "status")
        # the fields behind the name, which may hold spaces and brackets: proc(5)
        stat = _text(folder / f"task/{thread}/stat").rpartition(")")[2].split()
        if not status or len(stat) < 39:
            return self.known.get(thread)
        rows = dict(row.split(":", 1) for row in status.splitlines() if ":" in row)
        faults = int(stat[7]) + int(stat[9])
        found = self.known.setdefault(
            thread,
            Thread(
                thread, int(rows["Tgid"]), rows["Name"].strip(), "", 0,
                int(rows["PPid"]) == KERNEL_THREADS_PARENT, (time.monotonic(), faults),
            ),
        )  # fmt: skip
        found.priority = int(stat[37])
        found.policy = _POLICIES.get(int(stat[38]), f"policy {stat[38]}")
        found.last = time.monotonic(), faults
        return found


_POLICIES = {
    os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_RR: "SCHED_RR",
    os.SCHED_BATCH: "SCHED_BATCH", os.SCHED_IDLE: "SCHED_IDLE", 6: "SCHED_DEADLINE",
}  # fmt: skip


def _text(path: Path) -> str:
    """Return a file's text; empty if it is missing or has just disappeared."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
