# SPDX-License-Identifier: Apache-2.0
"""Counts the instructions of core_step() with valgrind's callgrind: a number that does not depend
on the machine's load. Sources, flags and libraries are those of csrc/build_ffi.py.

    python tests/bench/loop/core_instructions.py [TICKS]

Prints one JSON line; exit status 1 beyond the limits, 3 where valgrind is missing. `moving` and
`rest` are means of a four-wheel base at 1 kHz with feedback of all wheels every 10th tick and, when
moving, a new goal every 2 s; `moving_with_feedback` has feedback in every tick. Beside them,
without a limit: `ramping`, a new goal every 50 ms, so that no ramp ever ends, and `bases`: moving
and at rest by base and number of joints.
"""

from __future__ import annotations

import json
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
CSRC = HERE.parents[2] / "csrc"
TICKS = 20_000
MOVING_MAX = 900.0
FEEDBACK_MAX = 1800.0
RATIO_MAX = 1.2
GROWTH_MAX = 1.25
"""Limit of `growth`, above which the cost rises too fast with the number of joints."""
BASES = {
    "skid": (2, 4, 8),
    "omni": (3, 4, 8),
    "car": (2, 3, 4, 8),
    "swerve": (4, 8),
}
"""The numbers of joints, of 2, 3, 4 and 8, that each base can have."""
NEEDS = "valgrind is missing: apt install valgrind"


def compile_to(program: Path) -> None:
    build = runpy.run_path(str(CSRC / "build_ffi.py"))
    sources = [HERE / "core_instructions.c", *build["SOURCES"]]
    (good_config,) = HERE.parents[1].glob("c/**/good_config.h")
    folders = [*build["FOLDERS"], good_config.parent]
    libraries = [f"-l{name}" for name in (*build["LIBRARIES"], "pthread")]
    command = [
        "gcc",
        *build["FLAGS"],
        "-fPIC",
        "-g",
        *(f"-I{folder}" for folder in folders),
        *map(str, sources),
    ]
    subprocess.run([*command, "-o", str(program), *libraries], check=True, timeout=300)


def count(program: Path, mode: str, feedback_every_ticks: int, ticks: int, *base: object) -> float:
    """Return the mean instructions of a tick. `base`: kind and joints; default: four wheels."""
    with tempfile.NamedTemporaryFile(prefix="callgrind.") as out:
        done = subprocess.run(
            [
                "valgrind", "--tool=callgrind", "--toggle-collect=core_step",
                f"--callgrind-out-file={out.name}",
                str(program), mode, str(ticks), str(feedback_every_ticks), *map(str, base),
            ],
            capture_output=True, text=True, timeout=300, check=True,
        )  # fmt: skip
    collected = re.search(r"Collected : (\d+)", done.stderr)
    if collected is None:
        raise ValueError(f"valgrind gave no count: {done.stderr}")
    return int(collected.group(1)) / ticks


def of_bases(program: Path, ticks: int) -> dict[str, dict[int, tuple[float, float]]]:
    """Return the instructions of a tick, moving and at rest, by base and number of joints."""
    return {
        kind: {
            joints: (
                round(count(program, "moving", 10, ticks, kind, joints), 1),
                round(count(program, "rest", 10, ticks, kind, joints), 1),
            )
            for joints in numbers
        }
        for kind, numbers in BASES.items()
    }


def growth(found: dict[int, tuple[float, float]]) -> float:
    """Return the cost of one more joint between the two largest numbers of joints, relative to its
    mean cost from the smallest number on; 1: linear."""
    few, *between, many = sorted(found)
    middle = between[-1] if between else few
    late = (found[many][0] - found[middle][0]) / (many - middle)
    return late / ((found[many][0] - found[few][0]) / (many - few))


def measure(ticks: int) -> dict[str, Any] | None:
    """Return all figures, or None if there is no valgrind."""
    if shutil.which("valgrind") is None:
        return None
    with tempfile.TemporaryDirectory() as directory:
        program = Path(directory, "core_instructions")
        compile_to(program)
        moving, rest, ramping = (
            count(program, m, 10, ticks) for m in ("moving", "rest", "ramping")
        )
        fresh = count(program, "moving", 1, ticks)
        bases = of_bases(program, ticks // 4)
    return {
        "moving": round(moving, 1),
        "rest": round(rest, 1),
        "ratio": round(rest / moving, 3),
        "ramping": round(ramping, 1),
        "moving_with_feedback": round(fresh, 1),
        "growth": round(max(map(growth, bases.values())), 3),
        "bases": bases,
    }


def verdicts(found: dict[str, Any]) -> list[tuple[str, bool, bool]]:
    """Return verdicts as `wire.verdicts` does; no figure depends on the machine's load."""
    rows = (
        ("moving", MOVING_MAX, "instructions of a moving tick"),
        ("moving_with_feedback", FEEDBACK_MAX, "with feedback of four wheels"),
        ("ratio", RATIO_MAX, "at rest, of that when moving"),
        ("growth", GROWTH_MAX, "growth with the joints, of linear growth"),
    )
    return [
        (f"{what}: {found[name]:g} (at most {most:g})", found[name] <= most, True)
        for name, most, what in rows
    ]


def main(ticks: int) -> int:
    found = measure(ticks)
    if found is None:
        print(f"core_instructions: {NEEDS}", file=sys.stderr)
        return 3
    print(json.dumps(found))
    missed = [sentence for sentence, reached, _ in verdicts(found) if not reached]
    for sentence in missed:
        print(f"core_instructions: {sentence}", file=sys.stderr)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else TICKS))
