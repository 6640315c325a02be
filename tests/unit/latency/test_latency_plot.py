# SPDX-License-Identifier: Apache-2.0
"""The picture of a latency run, drawn from made-up runs."""

import dataclasses
import functools
import itertools
import math
import sys

import pytest
from click.testing import CliRunner

from motord.cli import cli
from motord.tools.latency.plot import (
    FLOOR_US,
    LOOP,
    PlotMissing,
    coarse,
    outline,
    plot,
    require_matplotlib,
)
from motord.tools.latency.report import NOTHING, Bar, LatencyReport, Spread, Window

MACHINE = {"kernel": "6.1", "preempt_rt": True, "virtual": False}


@pytest.fixture(autouse=True)
def _drawing():
    matplotlib("figure")


def matplotlib(name):
    """Return a module of matplotlib; it is imported only when a test of this file runs, and not by
    each process that collects all tests."""
    return pytest.importorskip(f"matplotlib.{name}", reason="needs matplotlib")


def made_up(*, cyclictest=True, timeline=True, overruns=0):
    late = Spread(1000, 10.0, 20.0, 30.0, 640.0)
    windows = tuple(
        Window(i * 0.1, (i + 1) * 0.1, 100, 20.0 + 300.0 * (i == 4), overruns * (i == 4))
        for i in range(10)
    )
    return LatencyReport(
        rate_hz=1000.0, seconds=1.0, ended_early=False, policy="SCHED_FIFO", priority=80, cpu=(),
        load="none", ticks=1000, overruns=overruns, page_faults=0, lateness_us=late, step_ns=late,
        handover_us={}, commands_sent=0, cyclictest_us=late if cyclictest else None,
        cyclictest_note="", refusals={}, machine=MACHINE, steal_percent=0.0,
        histogram=(Bar(0.0, 0.016, 3), Bar(9.7, 10.2, 900), Bar(10.2, 10.7, 90), Bar(640, 672, 1)),
        cyclictest_histogram=(Bar(9, 10, 70), Bar(40, 41, 2), Bar(41, 42, 3)) if cyclictest else (),
        timeline=windows if timeline else (),
    )  # fmt: skip


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Return a function that draws a made-up run; each is drawn once, as drawing takes long."""

    @functools.cache
    def picture(**kwargs):
        path = tmp_path_factory.mktemp("plot") / "plot.png"
        plot(made_up(**kwargs), path)
        assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
        return matplotlib("image").imread(path)

    return picture


@pytest.mark.parametrize("kwargs", [{}, {"cyclictest": False}, {"timeline": False}])
def test_the_picture_is_not_blank(drawn, kwargs):
    pixels = drawn(**kwargs)
    height, width = pixels.shape[:2]
    assert height > 400 < width
    for half in (pixels[: height // 2], pixels[height // 2 :]):
        assert (half[..., :3].min(axis=2) < 0.7).mean() > 0.005


def test_each_measure_is_drawn(drawn):
    plain = drawn()
    for kwargs in ({"cyclictest": False}, {"timeline": False}, {"overruns": 3}):
        assert (plain != drawn(**kwargs)).any(), kwargs


def test_a_run_without_measurements_can_be_drawn(tmp_path):
    empty = dataclasses.replace(
        made_up(cyclictest=False, timeline=False), lateness_us=NOTHING, histogram=()
    )
    plot(empty, tmp_path / "empty.png")
    assert (tmp_path / "empty.png").stat().st_size > 0


def test_microseconds_are_joined_to_buckets_of_the_loops_width_and_none_is_lost():
    bars = [Bar(us, us + 1, us + 1) for us in range(2000)]
    joined = coarse(bars)
    assert sum(bar.count for bar in joined) == sum(bar.count for bar in bars)
    assert all(a.high_us == b.low_us for a, b in itertools.pairwise(joined))
    for bar in joined:
        width_us = bar.high_us - bar.low_us
        assert width_us == 1 or math.isclose(width_us, 2 ** int(math.log2(bar.low_us)) / 16)


def test_a_gap_between_buckets_is_a_gap_in_the_outline():
    axes = matplotlib("figure").Figure().subplots()
    outline(axes, [Bar(0.0, 0.5, 7), Bar(4, 5, 1), Bar(5, 6, 2), Bar(8, 9, 3)], LOOP, "loop")
    counts, edges, _ = axes.patches[-1].get_data()
    assert list(edges) == [FLOOR_US, FLOOR_US * 1.06, 4, 5, 6, 8, 9]
    assert [None if math.isnan(count) else count for count in counts] == [7, None, 1, 2, None, 3]


def test_without_matplotlib_the_cure_is_named_before_anything_is_measured(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PlotMissing, match=r"-m pip install 'matplotlib>="):
        require_matplotlib()
    result = CliRunner().invoke(cli, ["latency", "--plot", str(tmp_path / "f.png")])
    assert result.exit_code == 1
    assert "-m pip install 'matplotlib>=" in result.stderr
    assert result.stdout == ""


def test_a_picture_in_no_folder_is_wrong_usage(tmp_path):
    result = CliRunner().invoke(cli, ["latency", "--plot", str(tmp_path / "no" / "f.png")])
    assert result.exit_code == 2
    assert "no folder" in result.stderr
