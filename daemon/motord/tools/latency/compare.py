# SPDX-License-Identifier: Apache-2.0
"""Compares two reports of `motord latency --json`. Pure, except `read_report`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motord.tools.latency.report import FIGURES, number
from motord_hal.base import bounded

SPREADS = (
    ("lateness_us",),
    ("cyclictest_us",),
    ("step_ns",),
    ("handover_us", "command_to_core"),
    ("handover_us", "core_to_asyncio"),
    ("handover_us", "command_to_byte"),
)
CONDITIONS = ("rate_hz", "policy", "priority", "cpu", "load")
REPORT_BYTES_MAX = 16 * 1024 * 1024
MACHINE = ("kernel", "preempt_rt", "cpu_model", "cpu_count", "virtual")


class ReportUnusable(ValueError):
    """The file is not a report of `motord latency --json`."""


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of both reports; None: the report does not have it."""

    name: str
    a: float | None
    b: float | None

    @property
    def ratio(self) -> float | None:
        """b / a; None if one is missing or a is zero."""
        return None if self.a is None or self.b is None or self.a == 0.0 else self.b / self.a

    def to_json(self) -> dict[str, float | None]:
        ratio = None if self.ratio is None else number(self.ratio)
        return {"a": self.a, "b": self.b, "ratio": ratio}


@dataclass(frozen=True, slots=True)
class Comparison:
    rows: tuple[Row, ...]
    classes: tuple[str, str]
    differences: dict[str, tuple[Any, Any]]
    """Conditions that differ between the two runs, and so also cause the ratios."""

    def to_json(self) -> dict[str, Any]:
        return {
            "class": {"a": self.classes[0], "b": self.classes[1]},
            "figures": {row.name: row.to_json() for row in self.rows},
            "differences": {k: {"a": a, "b": b} for k, (a, b) in self.differences.items()},
        }


def read_report(path: Path) -> dict[str, Any]:
    """Read a report. Raise ReportUnusable, with the file and its problem, if that fails."""
    try:
        report = json.loads(bounded.read(path, REPORT_BYTES_MAX))
    except (OSError, ValueError) as error:
        raise ReportUnusable(f"{path}: {error}") from error
    keys = {"rate_hz", "policy", "load", "class", "ticks", "overruns", "machine"}
    keys |= {spread[0] for spread in SPREADS}
    missing = sorted(keys - set(report)) if isinstance(report, dict) else sorted(keys)
    if missing:
        raise ReportUnusable(
            f"{path}: not a report of `motord latency --json`: no {', '.join(missing)}"
        )
    found: dict[str, Any] = report
    return found


def compare(a: dict[str, Any], b: dict[str, Any]) -> Comparison:
    """Compare every percentile of two reports; list the conditions that differ."""
    rows = [Row("overruns_percent", overruns_percent(a), overruns_percent(b))]
    rows += [
        Row(f"{'.'.join(keys)}.{name}", figure(a, keys, name), figure(b, keys, name))
        for keys in SPREADS
        for name in FIGURES
    ]
    rows += [
        Row(f"lateness_per_cyclictest.{name}", per_cyclictest(a, name), per_cyclictest(b, name))
        for name in FIGURES
    ]
    differences = {key: (a.get(key), b.get(key)) for key in CONDITIONS}
    differences |= {f"machine.{k}": (a["machine"].get(k), b["machine"].get(k)) for k in MACHINE}
    return Comparison(
        tuple(rows),
        (a["class"]["name"], b["class"]["name"]),
        {key: (x, y) for key, (x, y) in differences.items() if x != y},
    )


def figure(report: dict[str, Any], keys: tuple[str, ...], name: str) -> float | None:
    value: Any = report
    for key in (*keys, name):
        value = value.get(key) if isinstance(value, dict) else None
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def overruns_percent(report: dict[str, Any]) -> float | None:
    periods = report["ticks"] + report["overruns"]
    return 100.0 * report["overruns"] / periods if periods else None


def per_cyclictest(report: dict[str, Any], name: str) -> float | None:
    """Return the loop's lateness divided by cyclictest's at the same time. This ratio is comparable
    between machines."""
    return Row(
        name, figure(report, ("cyclictest_us",), name), figure(report, ("lateness_us",), name)
    ).ratio
