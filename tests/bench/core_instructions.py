# SPDX-License-Identifier: Apache-2.0
"""Counts the instructions of core_step() with valgrind's callgrind: a number that no load on the
machine moves.

Prints one JSON line; exit status 1 beyond the limits, 3 where valgrind is missing. `moving` and
`rest` are means of a four-wheel base at 1 kHz with feedback of all wheels every 10th tick and, when
moving, a new wish every 2 s. Beside them, without a limit: `ramping`, a new wish every 50 ms, so
that no ramp ever ends; `moving_with_feedback`, feedback in every tick.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
CSRC = HERE.parent.parent / "csrc"
PURE = "angle check core kinematics limit odometry pwm saturate"
FLAGS = ["-std=c11", "-O2", "-fPIC", "-g", "-ffp-contract=off", "-fno-fast-math", "-D_GNU_SOURCE"]
TICKS = 20_000
MOVING_MAX = 900.0
RATIO_MAX = 1.2


def compile_to(program: Path) -> None:
    sources = [HERE / "core_instructions.c", *(CSRC / f"{name}.c" for name in PURE.split())]
    command = ["gcc", *FLAGS, f"-I{CSRC}", *map(str, sources), "-o", str(program), "-lm"]
    subprocess.run(command, check=True, timeout=120)


def count(program: Path, mode: str, feedback_every_ticks: int) -> float:
    """Mean instructions of a tick."""
    with tempfile.NamedTemporaryFile(prefix="callgrind.") as out:
        done = subprocess.run(
            [
                "valgrind", "--tool=callgrind", "--toggle-collect=core_step",
                f"--callgrind-out-file={out.name}",
                str(program), mode, str(TICKS), str(feedback_every_ticks),
            ],
            capture_output=True, text=True, timeout=300, check=True,
        )  # fmt: skip
    collected = re.search(r"Collected : (\d+)", done.stderr)
    if collected is None:
        raise ValueError(f"valgrind gave no count: {done.stderr}")
    return int(collected.group(1)) / TICKS


def main() -> int:
    if shutil.which("valgrind") is None:
        print("core_instructions: valgrind is missing: apt install valgrind", file=sys.stderr)
        return 3
    with tempfile.TemporaryDirectory() as directory:
        program = Path(directory, "core_instructions")
        compile_to(program)
        moving, rest = count(program, "moving", 10), count(program, "rest", 10)
        fresh, ramping = count(program, "moving", 1), count(program, "ramping", 10)
    ratio = rest / moving
    result = {
        "moving": round(moving, 1),
        "rest": round(rest, 1),
        "ratio": round(ratio, 3),
        "ramping": round(ramping, 1),
        "moving_with_feedback": round(fresh, 1),
    }
    print(json.dumps(result))
    if moving <= MOVING_MAX and ratio <= RATIO_MAX:
        return 0
    print(
        f"core_instructions: at most {MOVING_MAX:.0f} moving, {RATIO_MAX} of that at rest",
        file=sys.stderr,
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())
