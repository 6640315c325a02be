# SPDX-License-Identifier: Apache-2.0
"""Compare the coverage of each file of csrc/ with its least numbers in coverage.toml.

python tests/c/thresholds.py SUMMARY [--write]

SUMMARY is what `gcovr --json-summary` writes. The exit status is 1 if a file has less than its
numbers, or has none. With --write, numbers that are lower than what was reached are raised, and
files without code any more are removed: a number never becomes lower by itself.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tomllib
from pathlib import Path

TABLE = Path(__file__).parent / "coverage.toml"
HEAD = """\
# Least coverage of each file of csrc/ by the C programs and tests/rt, in percent: lines, branches.
# `make coverage` fails below it. `make -C tests/c coverage WRITE=1` raises it to what was reached.
# What bus_receiver.c runs depends on the order of its threads: its numbers leave room for that.

"""

BY_CHANCE = ("bus/bus_receiver.c",)
"""Files whose numbers differ from run to run: they are changed by hand."""

Percents = tuple[float, float]


def percent(covered: int, total: int) -> float:
    """Return the part in percent, rounded down to a tenth; of nothing, 100."""
    return math.floor(1000 * covered / total) / 10 if total else 100.0


def reached(summary: dict[str, list[dict[str, str | int]]]) -> dict[str, Percents]:
    """Return (lines, branches) of each file with code."""
    return {
        str(file["filename"]).removeprefix("csrc/"): (
            percent(int(file["line_covered"]), int(file["line_total"])),
            percent(int(file["branch_covered"]), int(file["branch_total"])),
        )
        for file in summary["files"]
        if int(file["line_total"]) > 0
    }


def read_table() -> dict[str, Percents]:
    if not TABLE.exists():
        return {}
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return {name: (float(least[0]), float(least[1])) for name, least in table.items()}


def shortfalls(found: dict[str, Percents], table: dict[str, Percents]) -> list[str]:
    """Return a sentence for each number that is too low, and for each file without numbers."""
    rows = []
    for name, numbers in sorted(found.items()):
        if name not in table:
            rows.append(f"{name}: no numbers in coverage.toml")
            continue
        for kind, number, least in zip(("lines", "branches"), numbers, table[name], strict=True):
            if number < least:
                rows.append(f"{name}: {number} % of the {kind} ran, {least} % is the least")
    return rows


def raised(found: dict[str, Percents], table: dict[str, Percents]) -> dict[str, Percents]:
    """Return the table with each number at what was reached, but never lower than before."""
    nothing = (0.0, 0.0)
    return {
        name: table[name]
        if name in BY_CHANCE and name in table
        else (
            max(numbers[0], table.get(name, nothing)[0]),
            max(numbers[1], table.get(name, nothing)[1]),
        )
        for name, numbers in sorted(found.items())
    }


def text_of(table: dict[str, Percents]) -> str:
    rows = (f'"{name}" = [{lines}, {branches}]\n' for name, (lines, branches) in table.items())
    return HEAD + "".join(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description="coverage of csrc/ against its least numbers")
    parser.add_argument("summary", type=Path)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    found = reached(json.loads(asked.summary.read_text(encoding="utf-8")))
    if asked.write:
        TABLE.write_text(text_of(raised(found, read_table())), encoding="utf-8")
    for name, (lines, branches) in sorted(found.items()):
        print(f"{name:40} {lines:6.1f} % of the lines {branches:6.1f} % of the branches")
    low = shortfalls(found, read_table())
    for row in low:
        print(f"TOO LOW {row}")
    return int(bool(low))


if __name__ == "__main__":
    sys.exit(main())
