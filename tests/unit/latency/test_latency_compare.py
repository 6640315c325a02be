# SPDX-License-Identifier: Apache-2.0
"""Comparison of two latency reports."""

import copy
import json

import pytest
from click.testing import CliRunner

from motord.cli import cli
from motord.tools.latency.compare import ReportUnusable, compare, read_report


def spread(p50, p99, p99_9, worst):
    return {"samples": 1000, "p50": p50, "p99": p99, "p99_9": p99_9, "max": worst}


REPORT = {
    "rate_hz": 1000.0,
    "policy": "SCHED_FIFO",
    "priority": 80,
    "cpu": [],
    "load": "none",
    "class": {"name": "good", "limit_us": 20.0, "meaning": "fine"},
    "ticks": 990,
    "overruns": 10,
    "lateness_us": spread(4.0, 8.0, 12.0, 16.0),
    "step_ns": spread(100.0, 200.0, 300.0, 0.0),
    "cyclictest_us": spread(2.0, 4.0, 8.0, 16.0),
    "handover_us": {
        "command_to_core": spread(500.0, 900.0, 990.0, 1000.0),
        "core_to_asyncio": spread(20.0, 100.0, 200.0, 900.0),
        "command_to_byte": {"samples": 0, "p50": None, "p99": None, "p99_9": None, "max": None},
    },
    "machine": {"kernel": "6.1", "preempt_rt": True, "cpu_model": "x", "cpu_count": 4},
}


@pytest.fixture
def other():
    return copy.deepcopy(REPORT)


def rows(comparison):
    return {row.name: row for row in comparison.rows}


def test_a_ratio_is_the_second_by_the_first(other):
    other["lateness_us"]["p99"] = 20.0
    other["handover_us"]["core_to_asyncio"]["max"] = 90.0
    found = rows(compare(REPORT, other))
    assert found["lateness_us.p99"].ratio == 2.5
    assert found["handover_us.core_to_asyncio.max"].ratio == 0.1
    assert found["lateness_us.p50"].ratio == 1.0


def test_a_figure_that_is_missing_or_zero_has_no_ratio(other):
    other["cyclictest_us"] = None
    found = rows(compare(REPORT, other))
    assert found["cyclictest_us.p50"].to_json() == {"a": 2.0, "b": None, "ratio": None}
    assert found["lateness_per_cyclictest.p50"].to_json() == {"a": 2.0, "b": None, "ratio": None}
    assert found["handover_us.command_to_byte.p50"].ratio is None
    assert found["step_ns.max"].ratio is None


def test_the_loop_is_also_compared_by_what_cyclictest_saw_meanwhile(other):
    other["lateness_us"]["p99"], other["cyclictest_us"]["p99"] = 80.0, 40.0
    found = rows(compare(REPORT, other))
    assert found["lateness_us.p99"].ratio == 10.0
    assert found["lateness_per_cyclictest.p99"].ratio == 1.0


def test_overruns_are_a_share_of_all_periods(other):
    other["ticks"], other["overruns"] = 0, 0
    found = rows(compare(REPORT, other))
    assert found["overruns_percent"].a == pytest.approx(1.0)
    assert found["overruns_percent"].b is None


def test_conditions_that_differ_are_named(other):
    assert compare(REPORT, other).differences == {}
    other["load"] = "gil"
    other["machine"]["kernel"] = "6.12"
    assert compare(REPORT, other).differences == {
        "load": ("none", "gil"),
        "machine.kernel": ("6.1", "6.12"),
    }


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"rate_hz": 1}', "nonsense"])
def test_a_file_that_is_no_report_is_refused_by_name(tmp_path, text):
    path = tmp_path / "odd.json"
    path.write_text(text)
    with pytest.raises(ReportUnusable, match=r"odd\.json"):
        read_report(path)


def test_the_command_compares_two_files(tmp_path, other):
    other["lateness_us"]["p50"] = 6.0
    other["load"] = "io"
    paths = []
    for name, report in (("a.json", REPORT), ("b.json", other)):
        paths.append(str(tmp_path / name))
        (tmp_path / name).write_text(json.dumps(report))
    text = CliRunner().invoke(cli, ["latency", "--compare", *paths])
    assert text.exit_code == 0, text.output
    row = next(line for line in text.stdout.splitlines() if line.startswith("lateness_us.p50"))
    assert row.split() == ["lateness_us.p50", "4.000", "6.000", "1.500"]
    assert "differs: load: none and io" in text.stdout
    found = json.loads(CliRunner().invoke(cli, ["latency", "--json", "--compare", *paths]).stdout)
    assert found["figures"]["lateness_us.p50"] == {"a": 4.0, "b": 6.0, "ratio": 1.5}
    assert found["class"] == {"a": "good", "b": "good"}


def test_a_wrong_file_is_wrong_usage(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("{}")
    result = CliRunner().invoke(cli, ["latency", "--compare", str(path), str(path)])
    assert result.exit_code == 2
    assert "a.json" in result.stderr
