# SPDX-License-Identifier: Apache-2.0
"""Tests suspects: repeats the same measurement, each time with one thing changed."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from motord.tools.latency.causes.suspects import Suspect
from motord.tools.latency.load import load
from motord.tools.latency.measure import LatencyOptions, Progress, run_latency
from motord.tools.latency.report import LatencyReport

TRIAL_MAX_S = 5.0
PAUSED_MAX, CPUS_MAX = 3, 4
HIGHEST_PRIORITY = 99


@dataclass(frozen=True, slots=True)
class Trial:
    """One measurement with one thing changed. Its figures are per second, to be comparable with the
    first, which may be longer."""

    name: str
    late_per_s: float
    overruns_per_s: float

    def to_json(self) -> dict[str, Any]:
        return {
            "name": self.name, "late_per_s": round(self.late_per_s, 3),
            "overruns_per_s": round(self.overruns_per_s, 3),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Change:
    name: str
    options: LatencyOptions
    block: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext


def search(
    options: LatencyOptions,
    progress: Callable[[Progress], None],
    warn: Callable[[str], None],
    *,
    pause: bool,
    now: Callable[[str], None] = lambda _: None,
) -> LatencyReport:
    """Measure, then repeat it with each change that may remove the lateness. `pause`: also pause
    the suspected programs, one at a time. `now` gets the name of each trial. Errors as in
    `run_latency`."""
    with load(options.load, options.cpu):
        plain = replace(options, load="none", suspects=True)
        report = run_latency(plain, progress, warn)
        trials = []
        if report.verdict is not None and report.verdict.suspects and not report.ended_early:
            first = Trial("as it is", report.verdict.late_per_s, report.overruns / report.seconds)
            trials.append(first)
            for change in _changes(plain, report.verdict.suspects, pause=pause):
                now(change.name)
                with change.block():
                    again = run_latency(change.options, lambda _: None)
                if again.ended_early:
                    break
                late = again.verdict.late_per_s if again.verdict else 0.0
                trials.append(Trial(change.name, late, again.overruns / again.seconds))
    return replace(report, load=options.load, trials=tuple(trials))


def _changes(
    options: LatencyOptions, suspects: tuple[Suspect, ...], *, pause: bool
) -> Iterator[_Change]:
    short = replace(options, seconds=min(options.seconds, TRIAL_MAX_S))
    if 0 < options.priority < HIGHEST_PRIORITY:
        yield _Change(f"priority {HIGHEST_PRIORITY}", replace(short, priority=HIGHEST_PRIORITY))
    cpus = sorted(os.sched_getaffinity(0))
    for cpu in cpus[:CPUS_MAX] if len(cpus) > 1 else ():
        if options.cpu != (cpu,):
            yield _Change(f"loop on CPU {cpu} alone", replace(short, cpu=(cpu,)))
    named = list(dict.fromkeys((s.process, s.name) for s in suspects if s.process is not None))
    for process, name in named[:PAUSED_MAX] if pause else ():
        if process is not None and may_be_paused(process):
            block = functools.partial(paused, process)
            yield _Change(f"{name} (pid {process}) stopped", short, block)


def may_be_paused(process: int) -> bool:
    """Whether the process may be stopped: not this program or one that it descends from, init, a
    program of motord, or what has no command line (a kernel thread, or a program that has
    ended)."""
    protected, one = {1}, os.getpid()
    while one > 1 and one not in protected:
        protected.add(one)
        one = _parent(one)
    try:
        words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False  # the process has ended
    if not any(words):
        return False
    return process not in protected and not any(
        Path(os.fsdecode(word)).name in ("motord", "motord-bus") for word in words
    )


def _parent(process: int) -> int:
    try:
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 1


@contextlib.contextmanager
def paused(process: int) -> Iterator[None]:
    """Pause a process by a signal during this block; it goes on after it, whatever happened."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGCONT)
