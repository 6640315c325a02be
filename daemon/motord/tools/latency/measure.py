# SPDX-License-Identifier: Apache-2.0
"""`motord latency`: runs the real loop for some time and measures it. docs/latency.md has the
meaning of each figure."""

from __future__ import annotations

import asyncio
import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from motord.realtime.loop import Bucket, HistogramKind, Loop, LoopSettings, Percentiles
from motord.tools.latency.causes.machine import CpuTimes, machine_facts
from motord.tools.latency.causes.suspects import Verdict
from motord.tools.latency.causes.watcher import Watcher, late_from_ns
from motord.tools.latency.cyclictest import CyclictestResult, beside
from motord.tools.latency.load import load
from motord.tools.latency.other_end import Answers, LatencyError, OtherEnd, other_end, own_port
from motord.tools.latency.report import NOTHING, Bar, LatencyReport, Spread, Window
from motord.tools.latency.rig import Rig, core_config
from motord_hal.base.clock import within

__all__ = ["LatencyError", "LatencyOptions", "Progress", "measure", "run_latency"]

NOTIFY_MAX_HZ = 1000.0
"""Highest rate at which the loop wakes asyncio. A higher one takes all of a processor's time and
shows nothing more."""
WINDOW_S = 0.1
WINDOWS_MAX = 3000
"""Greatest number of windows, because a picture cannot show more. A long run has longer windows."""
PROGRESS_S = 0.5
CLEAR_DEADLINE_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyOptions:
    rate_hz: float = 1000.0
    seconds: float = 30.0
    priority: int = 80
    """Priority 1..99 with SCHED_FIFO; 0: SCHED_OTHER."""
    cpu: tuple[int, ...] = ()
    load: str = "none"
    suspects: bool = False
    """Whether to record the late ticks and what ran then."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Intermediate results of a run."""

    elapsed_s: float
    lateness: Percentiles
    overruns: int


class Timeline:
    """Collects windows of the loop's histogram. A histogram only grows, so the difference of two
    looks contains every tick between them; only its time is coarse."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._start_ns = time.monotonic_ns()
        self._before: list[Bucket] = []
        self._overruns = loop.status().overruns
        self.windows: list[Window] = []

    @property
    def elapsed_s(self) -> float:
        return self.windows[-1].end_s if self.windows else 0.0

    @property
    def overruns(self) -> int:
        return sum(window.overruns for window in self.windows)

    def look(self) -> None:
        """Add a window that ends now."""
        now_s = 1e-9 * (time.monotonic_ns() - self._start_ns)
        overruns = self._loop.status().overruns
        buckets = self._loop.buckets(HistogramKind.LATENESS)
        ticks, worst_ns = grown(self._before, buckets)
        self.windows.append(
            Window(self.elapsed_s, now_s, ticks, worst_ns * 1e-3, overruns - self._overruns)
        )
        self._before, self._overruns = buckets, overruns


def grown(before: list[Bucket], after: list[Bucket]) -> tuple[int, int]:
    """Return the number of new samples, and the upper edge in ns of their highest bucket."""
    counts = {bucket.low_ns: bucket.samples for bucket in before}
    new = [(b.high_ns, b.samples - counts.get(b.low_ns, 0)) for b in after]
    return sum(n for _, n in new), max((high_ns for high_ns, n in new if n), default=0)


def spread_ns(p: Percentiles) -> Spread:
    """Convert percentiles of the loop's histogram to a Spread in ns."""
    if p.samples == 0:
        return NOTHING
    return Spread(p.samples, p.p50_ns, p.p99_ns, p.p99_9_ns, p.max_ns)


def run_latency(
    options: LatencyOptions,
    progress: Callable[[Progress], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> LatencyReport:
    """Measure in the foreground; SIGINT or SIGTERM ends it early, with the results until then.

    `warn` gets a sentence for everything that the kernel refused, before the measurement. Raise
    LatencyError, LoadError, ValueError for options out of range, RuntimeError if a loop runs in
    this process already.
    """
    return asyncio.run(measure(options, progress, warn))


async def measure(
    options: LatencyOptions, progress: Callable[[Progress], None], warn: Callable[[str], None]
) -> LatencyReport:
    """Do the same as `run_latency` in an event loop that runs already, and measure this one."""
    if not (math.isfinite(options.seconds) and options.seconds > 0.0):
        raise ValueError(f"{options.seconds} s: a time greater than zero")
    settings = LoopSettings(
        rate_hz=options.rate_hz,
        priority=options.priority,
        cpu=options.cpu,
        notify_hz=min(options.rate_hz, NOTIFY_MAX_HZ),
        late_from_ns=late_from_ns(options.rate_hz) if options.suspects else 0,
    )
    loop = Loop(core_config(), settings)
    with own_port() as (far_fd, near_fd), load(options.load, options.cpu), loop:
        for sentence in loop.status().refusals.values():
            warn(sentence)
        async with other_end(far_fd, options.priority) as peer:
            rig = Rig(loop, peer.commands, near_fd, max(round(options.rate_hz / NOTIFY_MAX_HZ), 1))
            run = Run(options, loop, rig, peer)
            await run.drive(progress)
            return run.report(await peer.result())


class Run:
    """Runs one measurement and makes its report."""

    def __init__(self, options: LatencyOptions, loop: Loop, rig: Rig, peer: OtherEnd) -> None:
        self.options, self.loop, self.rig, self.peer = options, loop, rig, peer
        self.timeline = Timeline(loop)
        self.ended_early = False
        self.steal_percent = 0.0
        self.cyclictest = CyclictestResult(None, (), "")
        self.watcher = Watcher(loop, options.rate_hz) if options.suspects else None
        self.verdict: Verdict | None = None

    async def drive(self, progress: Callable[[Progress], None]) -> None:
        """Arm, measure for the requested time, stop the loop."""
        options = self.options
        await self.rig.arm(1.0 / options.rate_hz)
        with asked_to_end() as end, self.watcher or contextlib.nullcontext():
            async with beside(
                options.rate_hz,
                options.seconds,
                options.priority,
                options.cpu,
                suspects=options.suspects,
            ) as cyclictest:
                await self._forget_start()
                with self.rig.listening():
                    self.peer.begin()
                    await self._watch(end, progress)
                    self.peer.end()
                if self.watcher is not None:
                    self.verdict = self.watcher.verdict()
                self.loop.stop()
                self.timeline.look()
                self.cyclictest = await cyclictest.result()

    async def _watch(self, end: asyncio.Event, progress: Callable[[Progress], None]) -> None:
        seconds, cpu_times = self.options.seconds, CpuTimes.now()
        window_s = max(WINDOW_S, seconds / WINDOWS_MAX)
        begin_s = next_progress_s = time.monotonic()
        next_window_s = begin_s + window_s
        while (now_s := time.monotonic()) < begin_s + seconds and not end.is_set():
            self.rig.stay_alive()
            if self.watcher is not None:
                self.watcher.look()
            if now_s >= next_window_s:
                self.timeline.look()
                next_window_s = now_s + window_s
            if now_s >= next_progress_s:
                progress(self._so_far(now_s - begin_s))
                next_progress_s = now_s + PROGRESS_S
            with contextlib.suppress(TimeoutError):
                async with within(min(begin_s + seconds - now_s, WINDOW_S)):
                    await end.wait()
        self.ended_early = end.is_set()
        self.steal_percent = CpuTimes.now().steal_percent_since(cpu_times)

    def _so_far(self, elapsed_s: float) -> Progress:
        lateness = self.loop.percentiles(HistogramKind.LATENESS)
        return Progress(elapsed_s, lateness, self.timeline.overruns)

    async def _forget_start(self) -> None:
        """Let the loop clear the ticks before the measurement, and wait until it has done that."""
        self.timeline = Timeline(self.loop)
        if self.watcher is not None:
            self.watcher.begin()
        self.loop.clear_histograms()
        async with within(CLEAR_DEADLINE_S):
            while True:
                ticks = self.loop.status().ticks
                if self.loop.percentiles(HistogramKind.LATENESS).samples < ticks:
                    return
                await asyncio.sleep(1.0 / self.options.rate_hz)

    def report(self, answers: Answers) -> LatencyReport:
        """Make the report. Call it after the loop has stopped, so that the data do not change."""
        status, options = self.loop.status(), self.options
        lateness, step, command = (spread_ns(self.loop.percentiles(k)) for k in HistogramKind)
        age = self.rig.arrivals.age
        core_to_asyncio_ns = Spread.of_counts(age.counts, age.samples, age.max_ns)
        return LatencyReport(
            rate_hz=options.rate_hz,
            seconds=self.timeline.elapsed_s,
            ended_early=self.ended_early,
            policy=status.policy,
            priority=status.priority,
            cpu=options.cpu,
            load=options.load,
            ticks=lateness.samples,
            overruns=self.timeline.overruns,
            page_faults=status.page_faults,
            lateness_us=lateness.scaled(1e-3),
            step_ns=step,
            handover_us={
                "command_to_core": command.scaled(1e-3),
                "core_to_asyncio": core_to_asyncio_ns.scaled(1e-3),
                "command_to_byte": answers.command_to_byte_us,
            },
            commands_sent=answers.commands_sent,
            cyclictest_us=self.cyclictest.spread_us,
            cyclictest_note=self.cyclictest.note,
            refusals=status.refusals,
            machine=machine_facts(),
            steal_percent=self.steal_percent,
            histogram=tuple(
                Bar(bucket.low_ns * 1e-3, bucket.high_ns * 1e-3, bucket.samples)
                for bucket in self.loop.buckets(HistogramKind.LATENESS)
            ),
            cyclictest_histogram=self.cyclictest.histogram,
            timeline=tuple(self.timeline.windows),
            verdict=self.verdict,
        )


@contextlib.contextmanager
def asked_to_end() -> Iterator[asyncio.Event]:
    """Yield an event that SIGINT and SIGTERM set. Outside the main thread, where signals do not
    come, it is never set."""
    asked = asyncio.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    loop = asyncio.get_running_loop()
    signals = (signal.SIGINT, signal.SIGTERM)
    for number in signals:
        loop.add_signal_handler(number, asked.set)
    try:
        yield asked
    finally:
        for number in signals:
            loop.remove_signal_handler(number)
