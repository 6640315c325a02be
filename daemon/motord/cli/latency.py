# SPDX-License-Identifier: Apache-2.0
"""`motord latency`: how late the loop is on this machine, and how long handovers take."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motord.cli.common import Exit, Failure, json_option, print_json, usual_option
from motord.tools.latency.compare import Comparison, ReportUnusable, compare, read_report
from motord.tools.latency.load import LOADS
from motord.tools.latency.plot import PlotMissing, plot, require_matplotlib
from motord.tools.latency.report import FIGURES, LatencyReport

if TYPE_CHECKING:
    from motord.tools.latency.causes.suspects import Verdict

SUSPECTS_SHOWN = 5
UNRESPONSIVE_PERIOD_S = 5.0
"""Interval between two lines of progress if stderr is not a terminal."""


@click.command
@usual_option("--rate-hz", click.FloatRange(10.0, 20000.0), 1000.0, "Loop rate.")
@usual_option(
    "--seconds", click.FloatRange(0.2, 86400.0), 30.0,
    "Duration. Ctrl-C ends early and prints the results so far.",
)  # fmt: skip
@usual_option(
    "--priority", click.IntRange(0, 99), 80,
    "SCHED_FIFO priority of the loop; 0 selects SCHED_OTHER.",
)  # fmt: skip
@click.option(
    "--cpu",
    type=click.IntRange(0, 63),
    multiple=True,
    help="Bind the loop to this CPU. Repeatable. Default: any.",
)
@usual_option(
    "--load",
    click.Choice(LOADS),
    "none",
    "Load during the measurement: computing processes, writing processes, or a thread of this "
    "process that keeps Python's GIL busy; a process at SCHED_FIFO 90, one that forks, or one with "
    "a page-faulting thread.",
)
@click.option(
    "--suspects",
    is_flag=True,
    help="Find what makes ticks late: which program had the CPU, and what changes with it. "
    "Run it as root.",
)
@click.option(
    "--pause",
    is_flag=True,
    help="With --suspects: stop each program that is named for some seconds, one at a time.",
)
@click.option(
    "--plot",
    "picture",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="F.png",
    help="Draw a histogram and a time line. Needs the plot extra.",
)
@click.option(
    "--compare",
    "pair",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    nargs=2,
    metavar="A.json B.json",
    help="Compare two reports of --json side by side instead of measuring.",
)
@json_option
def latency(
    *,
    rate_hz: float,
    seconds: float,
    priority: int,
    cpu: tuple[int, ...],
    load: str,
    suspects: bool,
    pause: bool,
    picture: Path | None,
    pair: tuple[Path, Path] | None,
    as_json: bool,
) -> None:
    """Measure the timing of the control loop on this machine.

    Runs the real loop with the real core and without a motor, beside cyclictest if it is installed.
    It measures how late each tick wakes, how long its work takes, and the time from a command to
    the core, from the core to asyncio, and from a command to a byte on a port. It ends with the
    latency class of the machine.

    \b
    Example: motord latency
             motord latency --rate-hz 2000 --load gil --plot gil.png
             motord latency --json > before.json
             motord latency --compare before.json after.json
             sudo motord latency --suspects
    """
    if pair:
        show_comparison(pair, as_json=as_json)
        return
    if pause and not suspects:
        raise click.UsageError("--pause needs --suspects")
    from motord.tools.latency.load import LoadError
    from motord.tools.latency.measure import LatencyError, LatencyOptions, Progress, run_latency

    check_picture(picture)
    options = LatencyOptions(
        rate_hz=rate_hz, seconds=seconds, priority=priority, cpu=cpu, load=load
    )
    line = ProgressLine(seconds)

    def progress(now: Progress) -> None:
        line.show(
            now.elapsed_s,
            f"late by p99 {now.lateness.p99_ns * 1e-3:.0f} µs, max {now.lateness.max_ns * 1e-3:.0f}"
            f" µs, {now.overruns} overruns in {now.lateness.samples} ticks",
        )

    try:
        if suspects:
            from motord.tools.latency.trials import search

            report = search(options, progress, warn, pause=pause, now=line.note)
        else:
            report = run_latency(options, progress, warn)
    except (LatencyError, LoadError, TimeoutError, OSError) as error:
        raise Failure(str(error) or type(error).__name__) from error
    finally:
        line.end()
    if picture is not None:
        draw(report, picture)
    if as_json:
        print_json(report.to_json())
    else:
        click.echo(table(report))


def check_picture(picture: Path | None) -> None:
    """Check before the long measurement that a picture can be drawn. Raises Failure."""
    if picture is None:
        return
    try:
        require_matplotlib()
    except PlotMissing as error:
        raise Failure(str(error)) from error
    if not picture.parent.is_dir():
        raise Failure(f"--plot: there is no folder {picture.parent}", Exit.USAGE)


def draw(report: LatencyReport, picture: Path) -> None:
    """Draw the picture. If that fails, print the results first, so that they are not lost."""
    try:
        plot(report, picture)
    except OSError as error:
        click.echo(table(report), err=True)
        raise Failure(f"--plot: {error}") from error
    click.echo(f"plot: {picture}", err=True)


def warn(sentence: str) -> None:
    click.secho(f"WARNING: {sentence}", err=True, fg="red", bold=True)


class ProgressLine:
    """Progress on stderr: one line that is overwritten on a terminal, else a line every few
    seconds."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._terminal = sys.stderr.isatty()
        self._next_s = 0.0

    def show(self, elapsed_s: float, text: str) -> None:
        line = f"{elapsed_s:6.1f} s of {self._seconds:g}: {text}"
        if self._terminal:
            click.echo(f"\r\033[K{line}", nl=False, err=True)
        elif time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + UNRESPONSIVE_PERIOD_S
            click.echo(line, err=True)

    def note(self, text: str) -> None:
        """Show what is measured next."""
        self.end()
        click.echo(f"once more: {text}", err=True)

    def end(self) -> None:
        if self._terminal:
            click.echo("\r\033[K", nl=False, err=True)


def cells(name: str, spread: dict[str, Any]) -> str:
    figures = [
        "-" if spread[key] is None else f"{spread[key]:,.{0 if spread[key] >= 1000 else 1}f}"
        for key in FIGURES
    ]
    return f"  {name:<22}{spread['samples']:>10}" + "".join(f"{text:>11}" for text in figures)


def table(report: LatencyReport) -> str:
    """Return the results as a table for a person."""
    found = report.to_json()
    handover = found["handover_us"]
    outcome = (
        f"{report.overruns} of {report.ticks + report.overruns} periods overran; "
        f"{report.page_faults} page faults in the loop; "
        f"{handover['command_to_byte']['samples']} of {report.commands_sent} commands became "
        "a byte (the newest wins)"
    )
    lines = [
        *heading(report),
        "",
        f"  {'':<22}{'samples':>10}" + "".join(f"{key.replace('_', '.'):>11}" for key in FIGURES),
        cells("lateness, µs", found["lateness_us"]),
    ]
    if found["cyclictest_us"] is not None:
        lines.append(cells("cyclictest beside, µs", found["cyclictest_us"]))
    lines += [
        cells("step, ns", found["step_ns"]),
        cells("command → core, µs", handover["command_to_core"]),
        cells("core → asyncio, µs", handover["core_to_asyncio"]),
        cells("command → byte, µs", handover["command_to_byte"]),
        "",
        outcome,
    ]
    if found["cyclictest_us"] is None:
        lines.append(f"no cyclictest: {report.cyclictest_note}")
    lines += [f"REFUSED: {sentence}" for sentence in report.refusals.values()]
    if report.verdict is not None:
        lines += verdict_lines(report, report.verdict)
    lines.append(f"class: {report.latency_class}: {report.latency_class.meaning}")
    return "\n".join(lines)


def verdict_lines(report: LatencyReport, verdict: Verdict) -> list[str]:
    """Return the causes of late ticks, greatest share first, and what changed with each trial."""
    late = verdict.late_ticks + verdict.late_lost
    found = f"{late} ticks more than {verdict.late_from_us:g} µs late: {verdict.late_per_s:.1f} /s"
    lines = ["", found, *([verdict.note] if verdict.note else [])]
    if verdict.culprit is None:
        return [*lines, "there is no culprit"]
    stages = ", ".join(f"{name} {count}" for name, count in verdict.stages.items())
    lines.append(f"  longest stage: {stages}")
    lines += [f"  {tag}: {count}" for tag, count in verdict.tags.items()]
    shown = verdict.suspects[:SUSPECTS_SHOWN]
    lines += [f"  {100 * one.share:3.0f} %  {one.words}" for one in shown]
    for one in report.trials:
        rates = f"{one.late_per_s:8.1f} late ticks /s{one.overruns_per_s:8.1f} overruns /s"
        lines.append(f"  {one.name + ':':<40}{rates}")
    return [*lines, f"culprit: {verdict.culprit.words}", f"  fix: {verdict.culprit.cure}"]


def heading(report: LatencyReport) -> tuple[str, str]:
    """Return what was measured, and on which machine."""
    machine = report.machine
    early = ", ended early" if report.ended_early else ""
    priority = f" {report.priority}" if report.priority else ""
    kernel = "PREEMPT_RT" if machine["preempt_rt"] else "no PREEMPT_RT"
    virtual = f", virtual: {report.steal_percent:.1f} % stolen" if machine["virtual"] else ""
    run = f"{report.rate_hz:g} Hz for {report.seconds:.1f} s{early}"
    processor = f"{machine['cpu_count']} × {machine['cpu_model'] or machine['architecture']}"
    return (
        f"motord latency: {run}, {report.policy}{priority}, load: {report.load}",
        f"{processor}{virtual}; Linux {machine['kernel']} ({kernel})",
    )


def show_comparison(pair: tuple[Path, Path], *, as_json: bool) -> None:
    try:
        comparison = compare(*(read_report(path) for path in pair))
    except ReportUnusable as error:
        raise Failure(str(error), Exit.USAGE) from error
    if as_json:
        print_json({"files": {"a": str(pair[0]), "b": str(pair[1])}, **comparison.to_json()})
    else:
        click.echo(comparison_table(comparison, *(path.name for path in pair)))


def comparison_table(comparison: Comparison, a_name: str, b_name: str) -> str:
    def shown(value: float | None) -> str:
        return "-" if value is None else f"{value:,.3f}"

    width = max(14, len(a_name) + 2, len(b_name) + 2)
    lines = [f"{'':<36}{a_name:>{width}}{b_name:>{width}}{'B / A':>10}"]
    for row in comparison.rows:
        if row.a is not None or row.b is not None:
            values = "".join(f"{shown(value):>{width}}" for value in (row.a, row.b))
            lines.append(f"{row.name:<36}{values}{shown(row.ratio):>10}")
    lines.append(f"{'class':<36}" + "".join(f"  {name}" for name in comparison.classes))
    for key, (a, b) in comparison.differences.items():
        lines.append(f"differs: {key}: {a} and {b}")
    return "\n".join(lines)
