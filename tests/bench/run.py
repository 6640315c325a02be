# SPDX-License-Identifier: Apache-2.0
"""`make bench`: the cost and the lateness of motord beside the alternatives, in one run.

python -m tests.bench.run [--quick | --smoke] [--json] [--only core,wire,...] [--skip calibration]

Ends with 1 only where something is wrong (a violation, a page fault, too many instructions), never
because a machine is slow: the sentences report what was reached. `--smoke` runs every part as
briefly as it can, to show that it runs: no figure is judged.
"""

from __future__ import annotations

import argparse
import enum
import json
import sys
from typing import Any

from tests.bench import calibration
from tests.bench.bus import bus, dashboard
from tests.bench.command import bus_command, datagram, hung_daemon
from tests.bench.fieldbus import board_stream, can_bus, servo_bus, wire
from tests.bench.loop import core_instructions, culprits, lateness

Verdicts = list[tuple[str, bool, bool]]


class Size(enum.Enum):
    """Amount of measurement."""

    SMOKE = enum.auto()
    QUICK = enum.auto()
    WHOLE = enum.auto()


def core(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    ticks = 4000 if size is Size.SMOKE else core_instructions.TICKS
    found = core_instructions.measure(ticks)
    if found is None:
        return f"no instructions are counted: {core_instructions.NEEDS}", {}, []
    text = f"instructions of core_step, four wheels: {found}"
    return text, found, core_instructions.verdicts(found)


def on_the_wire(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    if size is Size.SMOKE:
        found = wire.arms()
        results = wire.measure(1, 0.3, [found[0], found[6], found[-1]])
        return wire.table(results), {}, []
    quick = size is Size.QUICK
    results = wire.measure(rounds=1 if quick else 3, seconds=2.0 if quick else 3.0)
    lines = "\n".join([wire.table(results), *wire.has_bench_tools()])
    return lines, {name: found.rounds for name, found in results.items()}, wire.verdicts(results)


def on_a_bus(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    seconds = {Size.SMOKE: 0.3, Size.QUICK: 3.0, Size.WHOLE: 6.0}[size]
    found = can_bus.measure(rounds=5 if size is Size.WHOLE else 1, seconds=seconds)
    return can_bus.table(found), found, can_bus.verdicts(found)


def bus_servos(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    seconds = {Size.SMOKE: 0.3, Size.QUICK: 2.0, Size.WHOLE: 5.0}[size]
    found = servo_bus.measure(rounds=3 if size is Size.WHOLE else 1, seconds=seconds)
    return servo_bus.table(found), found, servo_bus.verdicts(found)


def on_a_stream(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    seconds = {Size.SMOKE: 0.3, Size.QUICK: 3.0, Size.WHOLE: 6.0}[size]
    found = board_stream.measure(seconds)
    return board_stream.table(found), found, board_stream.verdicts(found)


def datagrams(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    found = datagram.measure({Size.SMOKE: 4, Size.QUICK: 60, Size.WHOLE: 200}[size])
    rows = [
        f"{name:8} p50 {row['p50_us']:6.0f}  p90 {row['p90_us']:6.0f}  p99 {row['p99_us']:6.0f} µs"
        f"  ({row['samples']:g} commands)"
        for name, row in found.items()
    ]
    return "\n".join(["from datagram to byte:", *rows]), found, datagram.verdicts(found)


def second_process(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    if size is Size.SMOKE:
        return "motord-bus runs", bus.smoke(), []
    found = bus.measure(size is Size.QUICK)
    return bus.table(found), found, bus.verdicts(found)


def from_twist(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    found = bus_command.measure({Size.SMOKE: 2, Size.QUICK: 40, Size.WHOLE: 200}[size])
    return bus_command.table(found), found, bus_command.verdicts(found)


def in_a_browser(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    seconds, rounds, times, heap_s, plots_s = {
        Size.SMOKE: (0.5, 1, 1, 0.0, 1.0), Size.QUICK: (5.0, 1, 20, 0.0, 10.0),
        Size.WHOLE: (15.0, 3, 100, 600.0, 60.0),
    }[size]  # fmt: skip
    found = dashboard.measure(seconds, rounds, times, heap_s, plots_s)
    return dashboard.table(found), found, dashboard.verdicts(found)


def wake_ups(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    pairs, seconds = {Size.SMOKE: (1, 1.0), Size.QUICK: (3, 3.0), Size.WHOLE: (9, 5.0)}[size]
    found = lateness.measure(pairs, seconds)
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


def late_ticks(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    seconds, pairs = {Size.SMOKE: (1.0, 1), Size.QUICK: (3.0, 1), Size.WHOLE: (10.0, 3)}[size]
    found = culprits.measure(seconds, pairs)
    return culprits.table(found), found, culprits.verdicts(found)


def calibrating(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    smoke = size is Size.SMOKE
    found = calibration.measure(*((0.5, calibration.SHORT) if smoke else ()))
    return calibration.table(found), found, calibration.verdicts(found)


def stopping_a_hung_daemon(size: Size) -> tuple[str, dict[str, Any], Verdicts]:
    runs = {Size.SMOKE: 1, Size.QUICK: 1, Size.WHOLE: 5}[size]
    found = hung_daemon.measure(runs, (0.0,) if size is Size.SMOKE else hung_daemon.HUNG_FOR_S)
    return hung_daemon.table(found), found, hung_daemon.verdicts(found)


PARTS = {
    "core": core,
    "wire": on_the_wire,
    "can": on_a_bus,
    "servos": bus_servos,
    "board": on_a_stream,
    "datagram": datagrams,
    "hung": stopping_a_hung_daemon,
    "lateness": wake_ups,
    "culprits": late_ticks,
    "calibration": calibrating,
    "bus": second_process,
    "twist": from_twist,
    "dashboard": in_a_browser,
}


def parts(text: str) -> list[str]:
    names = text.split(",")
    if unknown := [name for name in names if name not in PARTS]:
        raise argparse.ArgumentTypeError(f"no part {unknown[0]!r}; known: {', '.join(PARTS)}")
    return names


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="fewer rounds: two minutes")
    size.add_argument("--smoke", action="store_true", help="every part runs; nothing is judged")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--only", type=parts, default=list(PARTS), help="parts, with commas")
    parser.add_argument("--skip", type=parts, default=[], help="parts to leave out")
    asked = parser.parse_args()
    chosen = [part for part in PARTS if part in asked.only and part not in asked.skip]
    how_much = Size.SMOKE if asked.smoke else Size.QUICK if asked.quick else Size.WHOLE
    results: dict[str, Any] = {}
    verdicts: Verdicts = []
    for part in chosen:
        print(f"{part} ...", file=sys.stderr, flush=True)
        text, found, judged = PARTS[part](how_much)
        results[part] = found
        verdicts += judged if how_much is not Size.SMOKE else []
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
