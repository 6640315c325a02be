# SPDX-License-Identifier: Apache-2.0
"""Lateness of the loop's wake-ups and of cyclictest's: on the same CPU at the same time and
priority, so that a stall of the machine affects both, with a pure-Python hog in the loop's process.

"in band": samples later than 1 ms are left out on both sides; on a virtual machine they are the
host's.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import shutil
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PRIORITY, CPU = 80, 0
BAND_NS = 1_000_000
CYCLICTEST_EXTRA_S = 2.0
Bars = list[tuple[float, int]]
"""Bars of a histogram in order: lateness in ns, and number of samples."""


def percentile_ns(bars: Bars, fraction: float) -> float:
    """Return the lateness of the bar that contains this percentile of all samples."""
    wanted, seen = fraction * sum(n for _, n in bars), 0
    for value, samples in bars:
        seen += samples
        if seen >= wanted:
            return value
    return math.nan


def figures(bars: Bars) -> dict[str, float]:
    band = [(value, n) for value, n in bars if value < BAND_NS]
    return {"p50_us": percentile_ns(bars, 0.5) / 1e3, "p99_us": percentile_ns(bars, 0.99) / 1e3,
            "in_band_p99_9_us": percentile_ns(band, 0.999) / 1e3}  # fmt: skip


# ------------------------------------------------------------------------------- the loop's process
def child(rate_hz: float, seconds: float) -> None:
    """Run one loop with a hog beside it, then start processes; print the histogram of the first
    part, and the page faults of both parts together."""
    from motord.realtime import loop as rt
    from motord.tools.latency.rig import core_config

    def hog() -> None:
        while True:
            sum(range(1000))

    threading.Thread(target=hog, daemon=True).start()
    settings = rt.LoopSettings(rate_hz=rate_hz, priority=PRIORITY, cpu=(CPU,))
    with rt.Loop(core_config(), settings) as loop:
        time.sleep(0.2)
        loop.clear_histograms()
        print("ready", flush=True)
        time.sleep(seconds)
        bars = [((b.low_ns + b.high_ns) / 2, b.samples) for b in loop.buckets(rt.HistogramKind(0))]
        for _ in range(10):
            subprocess.run(["true"], check=True, timeout=60)
        seen = loop.status().ticks
        while loop.status().ticks < seen + 600:  # page faults are counted in every 256th tick
            time.sleep(0.01)
        status = loop.status()
        report = {"bars": bars, "page_faults": status.page_faults, "policy": status.policy}
        print(json.dumps(report), flush=True)


# ---------------------------------------------------------------------------------------- the pairs
def cyclictest_bars(text: str) -> Bars:
    """Return cyclictest's histogram; it rounds microseconds down, so half of one is added."""
    rows = re.findall(r"^(\d+)[ \t]+(\d+)\s*$", text, re.MULTILINE)
    return [((int(us) + 0.5) * 1e3, int(n)) for us, n in rows if int(n)]


def pair(rate_hz: float, seconds: float) -> dict[str, Any]:
    """Run the loop and cyclictest at once; return the figures of both."""
    with (
        subprocess.Popen(
            [sys.executable, HERE / "lateness.py", "child", str(rate_hz), str(seconds)],
            stdout=subprocess.PIPE, text=True,
        ) as ours,
    ):  # fmt: skip
        assert ours.stdout is not None
        assert ours.stdout.readline().strip() == "ready"
        theirs = subprocess.run(
            ["cyclictest", "-q", "-m", f"-p{PRIORITY}", f"-a{CPU}", f"-i{round(1e6 / rate_hz)}",
             f"-D{math.ceil(seconds)}", "-h20000"],
            capture_output=True, text=True, timeout=seconds + 30,
        )  # fmt: skip
        report = json.loads(ours.stdout.readline())
    bars = [(float(value), int(n)) for value, n in report["bars"]]
    return {"ours": figures(bars), "cyclictest": figures(cyclictest_bars(theirs.stdout)),
            "page_faults": report["page_faults"], "policy": report["policy"]}  # fmt: skip


def measure(pairs: int, seconds: float) -> dict[str, Any]:
    """Return {rate: {"pairs": [...], "ratios": medians, ...}}; it is empty without cyclictest."""
    found: dict[str, Any] = {}
    if shutil.which("cyclictest") is None:
        return found
    for rate_hz in (1000.0, 4000.0):
        rows = []
        for number in range(pairs):
            print(f"  {rate_hz:g} Hz, pair {number + 1} of {pairs}", file=sys.stderr, flush=True)
            rows.append(pair(rate_hz, seconds))
        ratios = {
            key: statistics.median(row["ours"][key] / row["cyclictest"][key] for row in rows)
            for key in ("p50_us", "p99_us", "in_band_p99_9_us")
        }
        faults = sum(row["page_faults"] for row in rows)
        found[f"{rate_hz:g}"] = {"pairs": rows, "ratios": ratios, "page_faults": faults}
    return found


def verdicts(found: dict[str, Any]) -> list[tuple[str, bool, bool]]:
    """Return the verdicts as `wire.verdicts` does."""
    verdicts = []
    for rate_hz, row in found.items():
        p99, p99_9 = row["ratios"]["p99_us"], row["ratios"]["in_band_p99_9_us"]
        sentence = (
            f"{rate_hz} Hz, {len(row['pairs'])} pairs: lateness p99 {p99:.2f} of cyclictest's "
            f"(1.25), in-band p99.9 {p99_9:.2f} (1.3)"
        )
        verdicts.append((sentence, p99 <= 1.25 and p99_9 <= 1.3, False))
    faults = sum(row["page_faults"] for row in found.values())
    if found:
        verdicts.append((f"page faults of the loop, also while Python starts processes: {faults}",
                     faults == 0, True))  # fmt: skip
    return verdicts


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        if sys.argv[1] == "child":
            child(float(sys.argv[2]), float(sys.argv[3]))
        else:
            print(json.dumps(measure(int(sys.argv[1]), float(sys.argv[2])), indent=1))
