# SPDX-License-Identifier: Apache-2.0
"""Runs cyclictest (rt-tests) beside the loop with the same rate, priority, processors and time, so
that a stall of the machine shows in both."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import shutil
import signal
from collections.abc import AsyncIterator
from dataclasses import dataclass

from motord.tools.latency.process import running
from motord.tools.latency.report import Bar, Spread
from motord_hal.base.clock import within

HISTOGRAM_US = 20_000
"""Upper end of cyclictest's histogram. Greater values are counted as overflow; percentiles among
them are replaced by the maximum."""
END_DEADLINE_S = 5.0


class CyclictestError(Exception):
    """cyclictest has no usable output; the message contains the reason."""


@dataclass(frozen=True, slots=True)
class CyclictestResult:
    """The result of cyclictest. Without a measurement, `spread_us` has no value (None) and `note`
    is the reason; else `note` is the command line."""

    spread_us: Spread | None
    histogram: tuple[Bar, ...]
    note: str


def command(rate_hz: float, seconds: float, priority: int, cpu: tuple[int, ...]) -> list[str]:
    """Return the command line of cyclictest. Priority 0 needs --policy=other: with -p0 alone,
    cyclictest raises itself to SCHED_FIFO."""
    scheduler = [f"-p{priority}"] if priority > 0 else ["--policy=other"]
    affinity = [f"-a{','.join(map(str, cpu))}"] if cpu else []
    return [
        "cyclictest", "-q", "--mlockall", *scheduler, *affinity, f"-i{round(1e6 / rate_hz)}",
        f"-D{math.ceil(seconds)}", f"-h{HISTOGRAM_US}",
    ]  # fmt: skip


def parse(text: str) -> tuple[Spread, tuple[Bar, ...]]:
    """Parse the histogram of one thread that `cyclictest -q -h` prints: lines `microseconds count`,
    then summary lines that begin with #. cyclictest rounds down to whole microseconds. Raise
    CyclictestError if there is no histogram, or no sample in it."""
    counts = {int(us): int(n) for us, n in re.findall(r"^(\d+)[ \t]+(\d+)\s*$", text, re.MULTILINE)}
    maximum = re.search(r"^# Max Latencies: *(\d+)\s*$", text, re.MULTILINE)
    overflows = re.search(r"^# Histogram Overflows: *(\d+)\s*$", text, re.MULTILINE)
    if not counts or maximum is None or overflows is None:
        raise CyclictestError("its output holds no histogram")
    samples = sum(counts.values()) + int(overflows.group(1))
    if samples == 0:
        raise CyclictestError("it ended before its first cycle")
    histogram = tuple(Bar(us, us + 1, n) for us, n in sorted(counts.items()) if n)
    return Spread.of_counts(counts, samples, float(maximum.group(1))), histogram


class Beside:
    """A running cyclictest. `result()` ends it and reads what it has counted until then."""

    def __init__(
        self, process: asyncio.subprocess.Process | None, line: list[str], why_not: str = ""
    ) -> None:
        self._process, self._line, self._why_not = process, line, why_not

    async def result(self) -> CyclictestResult:
        if self._process is None:
            return CyclictestResult(None, (), self._why_not)
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGINT)
        try:
            async with within(END_DEADLINE_S):
                out, err = await self._process.communicate()
        except TimeoutError:
            return CyclictestResult(None, (), "cyclictest did not end when it was stopped")
        try:
            spread_us, histogram = parse(out.decode(errors="replace"))
        except CyclictestError as error:
            words = " ".join(err.decode(errors="replace").split()) or str(error)
            return CyclictestResult(None, (), f"cyclictest gave no result: {words}")
        return CyclictestResult(spread_us, histogram, " ".join(self._line))


@contextlib.asynccontextmanager
async def beside(
    rate_hz: float, seconds: float, priority: int, cpu: tuple[int, ...], *, suspects: bool = False
) -> AsyncIterator[Beside]:
    """Run cyclictest in this block if it is installed; after the block it has ended, whatever
    happened. In the search for `suspects` it does not run: it has the loop's priority and would be
    a suspect."""
    line = command(rate_hz, seconds, priority, cpu)
    if suspects:
        yield Beside(None, line, "cyclictest does not run with --suspects")
        return
    if shutil.which(line[0]) is None:
        yield Beside(None, line, "cyclictest is not installed (package rt-tests)")
        return
    async with running(line) as process:
        cyclictest = Beside(process, line)
        try:
            yield cyclictest
        finally:
            # If it were killed, its file in /dev/shm would remain.
            if process.returncode is None:
                await cyclictest.result()
