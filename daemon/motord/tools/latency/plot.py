# SPDX-License-Identifier: Apache-2.0
"""The picture of a run: the lateness as a histogram and over time. It needs the extra `plot`."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from motord.base.extras import how_to_install
from motord.tools.latency.report import CLASSES, Bar, LatencyReport, Spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

LOOP, CYCLICTEST, MARK, MUTED = "#1f5fa8", "#e07b00", "#c22f2f", "#555555"
ONE_TICK = 0.7
"""Lower end of the histogram's count axis, so that a bucket with one tick is visible."""
LEGEND_ROOM = 2.5
FLOOR_US = 1.0
"""Least lateness in the picture (a logarithmic axis has no zero). Lower values are drawn here."""


class PlotMissing(RuntimeError):
    """matplotlib is not installed."""


def require_matplotlib() -> None:
    """Raise PlotMissing if matplotlib is not installed. Call it before the measurement."""
    if importlib.util.find_spec("matplotlib") is None:
        raise PlotMissing(f"a plot needs matplotlib: {how_to_install('plot')}")


def plot(report: LatencyReport, path: Path) -> None:
    """Write the picture of a run as a PNG file. Raise PlotMissing or OSError."""
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    top, bottom = figure.subplots(2, 1)
    figure.suptitle(
        f"motord latency: {report.rate_hz:g} Hz for {report.seconds:.1f} s", fontsize=15
    )
    draw_histogram(top, report)
    draw_timeline(bottom, report)
    figure.savefig(path, format="png", dpi=110)


def draw_histogram(axes: Axes, report: LatencyReport) -> None:
    axes.set_title(subtitle(report), fontsize=10, color=MUTED, pad=18)
    outline(axes, report.histogram, LOOP, legend("loop", report.lateness_us))
    if report.cyclictest_us is not None:
        text = legend("cyclictest beside it", report.cyclictest_us)
        outline(axes, coarse(report.cyclictest_histogram), CYCLICTEST, text)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(bottom=ONE_TICK)
    axes.set_xlabel("lateness: wake-up after its deadline, µs")
    axes.set_ylabel("ticks per bucket (16 an octave)")
    low_us, high_us = axes.get_xlim()
    axes.set_xlim(low_us, max(high_us, 60.0))
    plain_numbers(axes.xaxis)
    for limit_us in class_limits(*axes.get_xlim()):
        axes.axvline(limit_us, color=MUTED, linestyle=":", linewidth=1.0)
        label = f"{limit_us:g} µs"
        above = axes.get_xaxis_transform()
        axes.text(limit_us, 1.01, label, transform=above, fontsize=8, color=MUTED, ha="center")
    axes.grid(visible=True, which="major", alpha=0.25)
    if report.histogram:
        axes.legend(loc="upper right")


def plain_numbers(axis: Axis) -> None:
    """Label an axis with 10, 20, 50, 100 instead of powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def coarse(histogram: Sequence[Bar]) -> list[Bar]:
    """Convert cyclictest's buckets of 1 µs to the width of the loop's (16 an octave), so that the
    heights are comparable. Below 16 µs the buckets of 1 µs are wider than the loop's."""
    import numpy as np

    low_us = np.array([bar.low_us for bar in histogram], dtype=int)
    width_us = 1 << np.maximum(np.frexp(low_us)[1] - 5, 0)
    start_us, first, place = np.unique(
        low_us // width_us * width_us, return_index=True, return_inverse=True
    )
    counts = np.bincount(place, [bar.count for bar in histogram]).astype(int)
    end_us = start_us + width_us[first]
    return [Bar(*bar) for bar in zip(start_us, end_us, counts, strict=True)]


def outline(axes: Axes, histogram: Sequence[Bar], colour: str, label: str) -> None:
    """Draw buckets side by side. A gap between two buckets is a gap in the picture."""
    import numpy as np

    if not histogram:
        return
    low_us = np.maximum([bucket.low_us for bucket in histogram], FLOOR_US)
    high_us = np.maximum([bucket.high_us for bucket in histogram], FLOOR_US * 1.06)
    behind_gap = np.flatnonzero(low_us[1:] > high_us[:-1]) + 1
    edges = np.insert(np.append(low_us[0], high_us), behind_gap + 1, low_us[behind_gap])
    counts = np.insert([float(bucket.count) for bucket in histogram], behind_gap, math.nan)
    axes.stairs(counts, edges, fill=True, color=colour, alpha=0.35, baseline=ONE_TICK)
    axes.stairs(counts, edges, color=colour, linewidth=1.2, baseline=ONE_TICK, label=label)


def draw_timeline(axes: Axes, report: LatencyReport) -> None:
    windows = report.timeline
    span_ms = 1000.0 * report.seconds / max(len(windows), 1)
    axes.set_title(
        f"worst tick of each {span_ms:.0f} ms, every tick counted; an overrun is a period that "
        "was skipped",
        fontsize=10,
        color=MUTED,
    )
    if windows:
        edges = [windows[0].start_s, *(window.end_s for window in windows)]
        worst = [max(w.lateness_max_us, FLOOR_US) if w.ticks else math.nan for w in windows]
        axes.stairs(worst, edges, color=LOOP, linewidth=1.2, baseline=None, label="worst tick")
        axes.set_xlim(edges[0], edges[-1])
    missed = [w for w in windows if w.overruns]
    if missed:
        axes.scatter(
            [(w.start_s + w.end_s) / 2.0 for w in missed],
            [max(w.lateness_max_us, FLOOR_US) for w in missed],
            color=MARK,
            marker="v",
            zorder=3,
            label=f"with overruns ({report.overruns} in all)",
        )
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 8.0), max(high, 60.0) * LEGEND_ROOM)
    plain_numbers(axes.yaxis)
    for limit_us in class_limits(*axes.get_ylim()):
        axes.axhline(limit_us, color=MUTED, linestyle=":", linewidth=1.0)
        label, beside = f"{limit_us:g} µs", axes.get_yaxis_transform()
        axes.text(1.005, limit_us, label, transform=beside, fontsize=8, color=MUTED, va="center")
    axes.set_xlabel("time, s")
    axes.set_ylabel("lateness, µs")
    axes.grid(visible=True, which="major", alpha=0.25)
    if windows:
        axes.legend(loc="upper right")


def class_limits(low_us: float, high_us: float) -> list[float]:
    return [c.limit_us for c in CLASSES if low_us <= c.limit_us <= high_us]


def subtitle(report: LatencyReport) -> str:
    policy = f"{report.policy} {report.priority}" if report.priority else report.policy
    machine = report.machine
    kind = "PREEMPT_RT" if machine["preempt_rt"] else "no PREEMPT_RT"
    where = ", virtual machine" if machine["virtual"] else ""
    return (
        f"{policy} · load: {report.load} · class: {report.latency_class} · "
        f"Linux {machine['kernel']} ({kind}{where})"
    )


def legend(who: str, spread: Spread) -> str:
    return (
        f"{who}: p50 {spread.p50:.0f}, p99 {spread.p99:.0f}, "
        f"p99.9 {spread.p99_9:.0f}, max {spread.max:.0f} µs"
    )
