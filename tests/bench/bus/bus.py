# SPDX-License-Identifier: Apache-2.0
"""The cost of motord-bus, in one run: messages, memory, CPU, the delay of a command, and the
effects of stuck readers and of its own faults."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.bench.bus import bus_at_work, disturbed
from tests.bench.command import datagram

HERE = Path(__file__).parent
CDR_US, JSON_US = 0.5, 2.0
OFTEN = ("odom", "tf", "joint_states", "motor_status")
DAEMON_MB, BUS_MB, START_S = 40.0, 45.0, 1.0
LATER = 1.2
"""Ratio to the undisturbed lateness below which a disturbance has no measurable cost."""
Verdicts = list[tuple[str, bool, bool]]


def measure(quick: bool) -> dict[str, Any]:
    run = subprocess.run(
        [sys.executable, HERE / "bus_encode.py", "5" if quick else "15"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    count, seconds = (40, 3.0) if quick else (200, 10.0)
    return {
        "messages_us": json.loads(run.stdout),
        "memory_mb": bus_at_work.memory(),
        "cpu_percent": bus_at_work.cpu(seconds),
        "disturbed": disturbed.measure(2, 1, 3.0) if quick else disturbed.measure(9, 5, 4.0),
        "datagram": datagram.measure(count),
    }


def smoke() -> dict[str, Any]:
    """Run each measurement once, as briefly as possible."""
    bus_at_work.SETTLE_S = 0.3
    run = subprocess.run(
        [sys.executable, HERE / "bus_encode.py", "1"], capture_output=True, text=True, check=True
    )
    return {
        "messages_us": json.loads(run.stdout),
        "memory_mb": bus_at_work.memory(),
        "cpu_percent": bus_at_work.cpu(0.3, rates_hz=(bus_at_work.FAST_HZ,)),
        "disturbed": disturbed.struck("SIGKILL", 1, 1.0) | disturbed.readers(1, 1.0),
    }


def table(found: dict[str, Any]) -> str:
    rows = ["a message from snapshot to bytes, µs (in brackets: the Cyclone binding, json):"]
    for topic, forms in found["messages_us"].items():
        rows.append(
            f"  {topic:16} CDR {forms['cdr']:6.2f} ({forms['cdr, cyclone']:6.2f})"
            f"  JSON {forms['json']:6.2f} ({forms['json, stdlib']:6.2f})"
        )
    rows.append("memory, MB resident (shared pages shared out):")
    for name, one in found["memory_mb"].items():
        start = f"  {one['cpu_to_idle_s']:.2f} s of CPU to idle" if "cpu_to_idle_s" in one else ""
        rows.append(f"  {name:16} {one['rss']:6.1f} ({one['pss']:6.1f}){start}")
    rows.append("CPU of motord-bus with one publisher, all topics, % of one CPU:")
    for kind, rates in found["cpu_percent"].items():
        rows.append(f"  {kind:24}" + "  ".join(f"{n} {v:5.2f}" for n, v in rates.items()))
    rows.append("the loop beside it, disturbed by calm, medians of pairs:")
    for name, row in found["disturbed"].items():
        ratio, calm, other = row["ratio"], row["calm"], row["disturbed"]
        rows.append(
            f"  {name:22} lateness p50 {ratio['p50_us']:4.2f} p99 {ratio['p99_us']:4.2f}"
            f" ({other['p99_us']:.0f} by {calm['p99_us']:.0f} µs)"
            f"  exchanges {ratio['exchanges_per_tick']:5.3f}"
            f"  overruns {other['overruns']:g} by {calm['overruns']:g}"
            f"  errors {other['errors']:g} by {calm['errors']:g}"
        )
    rows.append("from datagram to byte, µs:")
    rows += [f"  {name:8} p50 {row['p50_us']:6.0f}  p90 {row['p90_us']:6.0f}  p99"
             f" {row['p99_us']:6.0f}" for name, row in found["datagram"].items()]  # fmt: skip
    return "\n".join(rows)


def verdicts(found: dict[str, Any]) -> Verdicts:
    """Return the verdicts as `wire.verdicts` does."""
    verdicts: Verdicts = []
    sent = found["messages_us"]
    for name, goal_us, topics in (("cdr", CDR_US, sent), ("json", JSON_US, OFTEN)):
        for topic in topics:
            one_us = sent[topic][name]
            text = f"{topic} from snapshot to {name}: {one_us:.2f} µs ({goal_us:g})"
            verdicts.append((text, one_us <= goal_us, False))
    memory = found["memory_mb"]
    daemon_mb, bus_mb = memory["daemon"]["rss"], memory["motord-bus"]["rss"]
    start_s = memory["daemon alone"]["cpu_to_idle_s"]
    verdicts += [
        (f"the daemon has {daemon_mb:.1f} MB ({DAEMON_MB:g})", daemon_mb <= DAEMON_MB, False),
        (f"motord-bus with ROS 2 has {bus_mb:.1f} MB ({BUS_MB:g})", bus_mb <= BUS_MB, False),
        (f"{start_s:.2f} s of CPU to idle ({START_S:g})", start_s <= START_S, False),
    ]
    for name, row in found["disturbed"].items():
        late = row["ratio"]["p99_us"]
        verdicts.append(
            (f"{name}: lateness p99 {late:.2f} times ({LATER:g})", late <= LATER, False)
        )
    return verdicts
