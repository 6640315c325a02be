# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs for what is written in Python.

    python tests/fuzz/fuzz.py --runs 2000 --seed 7 guard socket robot-file recording

Prints the seed, and each problem with the beginning of its input; the whole input is in a file of
build/fuzz, and the exit status is 1. One run of "guard" is one line that gets many replies, one of
"socket" a connection with many lines.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("tests/fuzz", "tests/contract", "tests/contract/lines", "tests/contract/modbus")
sys.path[:0] = [str(ROOT / part) for part in (*FOLDERS, "daemon", "hal", ".")]

import guard  # noqa: E402  # the path is made above
import local_socket  # noqa: E402
import recording  # noqa: E402
import robot_file  # noqa: E402

TARGETS = {
    "robot-file": (robot_file.run, 1),
    "socket": (local_socket.run, 50),
    "guard": (guard.run, 50),
    "recording": (recording.run, 1),
}
"""Each target's function, and the number of --runs for one run of it: their costs differ."""
PROBLEMS_MAX = 5
SHOWN_BYTES = 400
FAILED = ROOT / "build/fuzz"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", default=list(TARGETS), metavar="TARGET",
                        help=f"{', '.join(TARGETS)}; default: all")  # fmt: skip
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=None, help="default: a random one, printed")
    arguments = parser.parse_args()
    if unknown := set(arguments.targets) - set(TARGETS):
        parser.error(f"no target {', '.join(sorted(unknown))}; there are {', '.join(TARGETS)}")
    seed = random.randrange(1 << 31) if arguments.seed is None else arguments.seed
    return max(_fuzz(name, seed, arguments.runs) for name in arguments.targets)


def _fuzz(name: str, seed: int, runs: int) -> int:
    run, cost = TARGETS[name]
    runs = max(1, runs // cost)
    began_s = time.monotonic()
    print(f"fuzz {name}: {runs} runs, seed {seed}", file=sys.stderr, flush=True)
    problems = 0
    for problem, data in run(seed, runs):
        problems += 1
        FAILED.mkdir(parents=True, exist_ok=True)
        path = FAILED / f"{name}-{seed}-{problems}"
        path.write_bytes(data)
        shown = f"{problem}\n  {path.relative_to(ROOT)}: {data[:SHOWN_BYTES]!r}"
        print(f"fuzz {name}, seed {seed}: {shown}", file=sys.stderr, flush=True)
        if problems == PROBLEMS_MAX:
            break
    took_s = time.monotonic() - began_s
    verdict = f"{problems} problems" if problems else "no problem"
    print(f"fuzz {name}: {verdict}, {took_s:.0f} s", file=sys.stderr, flush=True)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
