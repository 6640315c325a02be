# SPDX-License-Identifier: Apache-2.0
"""`make bench`: what motord costs and how late it is, beside what people use instead, in one run.

python tests/bench/run.py [--quick] [--json] [--only core,wire,can,board,datagram,lateness,bus]

Ends with 1 only where something is wrong (a violation, a page fault), never because a machine is
slow: the sentences say what was reached.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import board_stream
import bus
import can_bus
import datagram
import lateness
import wire

HERE = Path(__file__).parent
PARTS = ("core", "wire", "can", "board", "datagram", "lateness", "bus")
Verdicts = list[tuple[str, bool, bool]]


def core() -> tuple[str, dict[str, Any], Verdicts]:
    run = subprocess.run(
        [sys.executable, HERE / "core_instructions.py"], capture_output=True, text=True, check=True
    )
    found = json.loads(run.stdout)
    return f"instructions of core_step, four wheels: {found}", found, []


def on_the_wire(quick: bool) -> tuple[str, dict[str, Any], Verdicts]:
    results = wire.measure(rounds=1 if quick else 3, seconds=2.0 if quick else 3.0)
    said = "\n".join([wire.table(results), *wire.has_bench_tools()])
    return said, {name: found.rounds for name, found in results.items()}, wire.verdicts(results)


def on_a_bus(quick: bool) -> tuple[str, dict[str, Any], Verdicts]:
    found = can_bus.measure(rounds=1 if quick else 5, seconds=3.0 if quick else 6.0)
    return can_bus.table(found), found, can_bus.verdicts(found)


def on_a_stream(quick: bool) -> tuple[str, dict[str, Any], Verdicts]:
    found = board_stream.measure(seconds=3.0 if quick else 6.0)
    return board_stream.table(found), found, board_stream.verdicts(found)


def datagrams(quick: bool) -> tuple[str, dict[str, Any], Verdicts]:
    found = datagram.measure(60 if quick else 200)
    rows = [
        f"{name:8} p50 {row['p50_us']:6.0f}  p90 {row['p90_us']:6.0f}  p99 {row['p99_us']:6.0f} µs"
        f"  ({row['samples']:g} commands)"
        for name, row in found.items()
    ]
    return "\n".join(["from datagram to byte:", *rows]), found, datagram.verdicts(found)


def second_process(quick: bool) -> tuple[str, dict[str, Any], Verdicts]:
    found = bus.measure(quick)
    return bus.table(found), found, bus.verdicts(found)


def wake_ups(quick: bool) -> tuple[str, dict[str, Any], Verdicts]:
    found = lateness.measure(pairs=3 if quick else 9, seconds=3.0 if quick else 5.0)
    if not found:
        return "cyclictest is not installed (apt install rt-tests): no lateness pairs", {}, []
    rows = []
    for rate_hz, row in found.items():
        for number, one in enumerate(row["pairs"], 1):
            ours, theirs = (
                " / ".join(f"{value:.0f}" for value in one[who].values())
                for who in ("ours", "cyclictest")
            )
            rows.append(f"{rate_hz} Hz pair {number}:  ours {ours}  cyclictest {theirs}")
    head = "lateness p50 / p99 / in-band p99.9 in µs, both on one CPU at once:"
    return "\n".join([head, *rows]), found, lateness.verdicts(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer rounds: two minutes")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--only", default=",".join(PARTS), help="parts, with commas between")
    asked = parser.parse_args()
    chosen = [part for part in PARTS if part in asked.only.split(",")]
    results, verdicts = {}, []
    for part in chosen:
        print(f"{part} ...", file=sys.stderr, flush=True)
        if part == "core":
            text, found, said = core()
        else:
            measure = {
                "wire": on_the_wire,
                "can": on_a_bus,
                "board": on_a_stream,
                "datagram": datagrams,
                "lateness": wake_ups,
                "bus": second_process,
            }
            text, found, said = measure[part](asked.quick)
        results[part] = found
        verdicts += said
        if not asked.json:
            print(f"{text}\n", flush=True)
    wrong = any(matters and not reached for _, reached, matters in verdicts)
    if asked.json:
        print(json.dumps({"results": results, "verdicts": verdicts, "ok": not wrong}))
    else:
        for sentence, reached, _ in verdicts:
            print(f"{'reached' if reached else 'missed '}  {sentence}")
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
