# SPDX-License-Identifier: Apache-2.0
"""Checks whether `motord latency --suspects` names the cause of a delay of the loop: a SCHED_FIFO
hog, a process that forks, a page-faulting thread, each on the loop's processor. Also measures what
the search costs the loop.

python culprits.py: one JSON object.
"""

from __future__ import annotations

import json
import os
import statistics
from typing import Any

from motord.tools.latency.load import CULPRITS
from motord.tools.latency.measure import LatencyOptions, run_latency
from motord.tools.latency.trials import search

KINDS = {"fifo": "real-time thread", "fork": "fork", "faults": "page faults"}
"""Kind of suspect that has to be named for each culprit."""


def measure(seconds: float, pairs: int) -> dict[str, Any]:
    """Return the figures by culprit, and in `cost` those of the search's cost."""
    cpu = (max(os.sched_getaffinity(0)),)
    found: dict[str, Any] = {}
    for kind in CULPRITS:
        options = LatencyOptions(seconds=seconds, cpu=cpu, load=kind)
        report = search(options, lambda _: None, lambda _: None, pause=False)
        assert report.verdict is not None
        suspects = report.verdict.suspects
        ranks = [n for n, one in enumerate(suspects, 1) if one.kind == KINDS[kind]]
        found[kind] = {
            "policy": report.policy,
            "named": suspects[0].words if suspects else "",
            "share": suspects[0].share if suspects else 0.0,
            "rank": ranks[0] if ranks else 0,
            "overruns": report.overruns,
            "trials": [one.to_json() for one in report.trials],
        }
    return found | {"cost": cost(seconds, pairs)}


def cost(seconds: float, pairs: int) -> dict[str, float]:
    """Return medians of the tick's work, with the search off and on in turns, and their ratio."""
    found: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(pairs):
        for searched, row in found.items():
            options = LatencyOptions(seconds=seconds, suspects=searched)
            row.append(run_latency(options).step_ns.p50)
    off, on = (statistics.median(row) for row in found.values())
    return {"off_ns": off, "on_ns": on, "ratio": on / off}


def table(found: dict[str, Any]) -> str:
    rows = [f"{kind:7} {found[kind]['share']:4.0%} {found[kind]['named']}" for kind in CULPRITS]
    paid = found["cost"]
    words = f"the tick's work, p50: {paid['off_ns']:.0f} ns; searched: {paid['on_ns']:.0f} ns"
    return "\n".join(["motord latency --suspects names:", *rows, words])


def verdicts(found: dict[str, Any]) -> list[tuple[str, bool, bool]]:
    named = sum(found[kind]["rank"] == 1 for kind in CULPRITS)
    return [(f"the culprit is named first in {named} of {len(CULPRITS)}", named == 3, False)]


if __name__ == "__main__":
    print(json.dumps(measure(5.0, 3), indent=1))
