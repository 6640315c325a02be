# SPDX-License-Identifier: Apache-2.0
"""Thousands of seeded faults on moving four-drive robots, run by the real daemon.

    python tests/soak/soak.py --faults 10000 --seed 7 --engine both --workers 2

It checks that the core gets no count that its drive has not reported, that no wheel exceeds its
limit, and that after the faults the robot comes to rest, is reset and armed, and drives again. Exit
status 1 on any violation.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import random
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / part) for part in ("tests/soak", "daemon", "hal", ".")]

from fault_mix import SERIAL_KINDS  # noqa: E402  # the path is made above
from hurt_robot import Outcome, live  # noqa: E402

LIFE_FAULTS = 500
BATCH = 40
ENGINES = {"rt": ("rt",), "asyncio": ("asyncio",), "both": ("rt", "asyncio")}


def lives(faults: int, seed: int, engine: str) -> list[tuple[int, str, int]]:
    """Return seed, engine and number of faults of each robot."""
    dice, left, planned = random.Random(seed), faults, []
    engines = ENGINES[engine]
    while left > 0:
        count = min(LIFE_FAULTS, left)
        planned.append((dice.randrange(1 << 31), engines[len(planned) % len(engines)], count))
        left -= count
    return planned


def soak(arguments: argparse.Namespace) -> list[Outcome]:
    """Run all lives, `workers` at once. A thread only talks to the processes of its robot."""
    planned = lives(arguments.faults, arguments.seed, arguments.engine)
    lock, done = threading.Lock(), []

    def one(plan: tuple[int, str, int]) -> Outcome:
        seed, engine, count = plan
        outcome = live(
            seed, engine, count, arguments.batch, arguments.kinds, lambda text: _say(lock, text)
        )
        done.append(outcome)
        verdict = "ok" if not outcome.violations else "VIOLATION"
        _say(lock, f"{len(done)}/{len(planned)} robots: {engine}, seed {seed}, {count} faults,"
                   f" {outcome.duration_s:.0f} s, {verdict}")  # fmt: skip
        for violation in outcome.violations:
            _say(lock, f"  {violation}")
        return outcome

    with ThreadPoolExecutor(arguments.workers) as pool:
        return list(pool.map(one, planned))


def _say(lock: threading.Lock, text: str) -> None:
    with lock:
        print(text, file=sys.stderr, flush=True)


def summary(outcomes: list[Outcome], seed: int, duration_s: float) -> dict[str, object]:
    """Return the report that is printed at the end."""
    counts: Counter[str] = Counter()
    for outcome in outcomes:
        counts += outcome.faults
    return {
        "seed": seed,
        "faults": counts.total(),
        "by_kind": dict(sorted(counts.items())),
        "robots": len(outcomes),
        "recoveries": sum(outcome.recoveries for outcome in outcomes),
        "slowest_recovery_s": max(outcome.slowest_recovery_s for outcome in outcomes),
        "counts_checked": sum(outcome.checked_counts for outcome in outcomes),
        "old_answers": sum(outcome.old_answers for outcome in outcomes),
        "oldest_answer_s": max(outcome.oldest_s for outcome in outcomes),
        "watchdog_bites": sum(outcome.watchdog_bites for outcome in outcomes),
        "gap_violations": sum(outcome.gap_violations for outcome in outcomes),
        "duration_s": duration_s,
        "violations": [text for outcome in outcomes for text in outcome.violations],
        "lives": [
            {**dataclasses.asdict(outcome), "faults": outcome.faults.total()}
            for outcome in outcomes
        ],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=None, help="default: a random one, printed")
    parser.add_argument("--engine", choices=ENGINES, default="both")
    parser.add_argument("--workers", type=int, default=3, help="robots at once")
    parser.add_argument("--batch", type=int, default=BATCH, help="faults at once")
    parser.add_argument(
        "--kinds", nargs="+", choices=SERIAL_KINDS, default=SERIAL_KINDS, metavar="KIND"
    )
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if arguments.seed is None:
        arguments.seed = random.randrange(1 << 31)
    print(f"seed {arguments.seed}", file=sys.stderr, flush=True)
    began_s = time.monotonic()
    outcomes = soak(arguments)
    found = summary(outcomes, arguments.seed, time.monotonic() - began_s)
    if arguments.json:
        print(json.dumps(found))
    else:
        _print(found)
    return 1 if found["violations"] else 0


def _print(found: dict[str, object]) -> None:
    for name, value in found.items():
        if name not in ("lives", "by_kind", "violations"):
            print(f"{name:20} {value:.3g}" if isinstance(value, float) else f"{name:20} {value}")
    by_kind = found["by_kind"]
    assert isinstance(by_kind, dict)
    print("by kind:", ", ".join(f"{kind} {count}" for kind, count in by_kind.items()))
    print("verdict:", "VIOLATIONS" if found["violations"] else "no violation")


if __name__ == "__main__":
    sys.exit(main())
