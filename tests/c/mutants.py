# SPDX-License-Identifier: Apache-2.0
"""Are the C tests good? Each mutant is the file with one small mistake in it; tests that still
pass do not see it.

python tests/c/mutants.py [FILE] [--tests test_rtu,...]

FILE is rtu.c unless something else is said.

Ends with 1 where a mutant survives that is not listed in mutants.toml as the same program in
other words.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
CSRC = HERE.parents[1] / "csrc"
FLAGS = ["-std=c11", "-D_GNU_SOURCE", "-ffp-contract=off", "-O1", "-w", f"-I{CSRC}"]
# a mutant may run on beyond an array: the sanitizers see it
WATCHED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
RUN_WITHIN_S = 60.0
_LINE = ["test_line_stops", "test_line_rates", "test_line_packets", "fuzz_line 2000"]
_BOARD = ["test_board", "test_board_words", "fuzz_board 3000"]
_CAN = [
    "test_can",
    "test_can_stops",
    "test_can_drive",
    "test_can_quiet",
    "test_can_values",
    "test_can_looks",
    "fuzz_can 2000",
]
TESTS = {
    "rtu.c": ["test_rtu"],
    "arbiter.c": ["test_command"],
    "joints.c": ["test_command"],
    "gyro.c": ["test_gyro"],
    "encoder.c": ["test_encoder"],
    **dict.fromkeys(["can_machine.c", "can_drive.c", "can_values.c", "can_table.c"], _CAN),
    **dict.fromkeys(
        ["line_machine.c", "line_drive.c", "line_quiet.c", "line_end.c", "line_values.c"], _LINE
    ),
    **dict.fromkeys(
        ["board_machine.c", "board_drive.c", "board_values.c", "board_frame.c", "board_imu.c"],
        _BOARD,
    ),
}
"""Programs and their arguments, the quickest first."""

_SWAPS = {
    "==": ["!="], "!=": ["=="], "<=": ["<", ">"], ">=": [">", "<"], "<": ["<=", ">"],
    ">": [">=", "<"], "&&": ["||"], "||": ["&&"], "+": ["-"], "-": ["+"], "*": ["+"], "/": ["*"],
    "%": ["+"], "&": ["|"], "|": ["&"], "^": ["|"], "<<": [">>"], ">>": ["<<"], "++": ["--"],
    "--": ["++"], "+=": ["-="], "-=": ["+="], "^=": ["="], "|=": ["="], ">>=": ["<<="],
    "!": [""], "true": ["false"], "false": ["true"],
}  # fmt: skip
_TOKEN = re.compile(
    r"""(?P<skip>/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|^[ \t]*\#[^\n]*|->)"""
    r"""|(?P<number>\b(?:0[xX][0-9a-fA-F]+|\d+)[uUlL]*\b)"""
    r"""|(?P<op><<=|>>=|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||\+=|-=|\^=|\|=|[-+*/%&|^<>!]"""
    r"""|\btrue\b|\bfalse\b)"""
    r"""|(?P<statement>^[ \t]+(?:return\b[^;{}]*"""
    r"""|[\w\[\]>.\-*()& +]+(?:\s=|\s[|^+\-]=|<<=|>>=)[^;{}]*|\w+\([^;{}]*\));[ \t]*$)""",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True)
class Mutant:
    line: int
    what: str
    text: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.what}"


def _pieces(source: str) -> Iterator[tuple[int, int, str, str]]:
    """(begin, end, kind, text) of what may be changed; inside whole statements, too."""
    for found in _TOKEN.finditer(source):
        kind = found.lastgroup or "skip"
        if kind == "skip":
            continue
        yield found.start(), found.end(), kind, found.group()
        if kind == "statement":
            for inner in _TOKEN.finditer(found.group().lstrip().replace("\n", " ")):
                if inner.lastgroup in ("number", "op"):
                    shift = found.start() + len(found.group()) - len(found.group().lstrip())
                    yield shift + inner.start(), shift + inner.end(), inner.lastgroup, inner.group()


def _changes(kind: str, text: str) -> list[str]:
    if kind == "op":
        return _SWAPS.get(text, [])
    if kind == "number":
        digits = text.rstrip("uUlL")
        suffix = text[len(digits) :]
        decimal = not digits.lower().startswith("0x")
        value, width = int(digits, 10 if decimal else 16), len(digits) if decimal else 0
        near = [value + 1, value - 1] if value > 0 else [value + 1]
        return [f"{other:0{width}}{suffix}" for other in near]  # the zeros of 0.01 stay
    return [";" if not text.lstrip().startswith("return") else ""]


def mutants(source: str) -> list[Mutant]:
    """All of them, in the file's order."""
    found = []
    for begin, end, kind, text in _pieces(source):
        for new in _changes(kind, text):
            if kind == "statement" and not new:
                continue  # without its return a function does not compile to anything defined
            line = source.count("\n", 0, begin) + 1
            shown = text.strip().replace("\n", " ")
            what = f"{shown} removed" if kind == "statement" else f"{shown} -> {new or 'nothing'}"
            line_text = source.splitlines()[line - 1].strip()
            found.append(
                Mutant(line, f"{what}   in: {line_text}", source[:begin] + new + source[end:])
            )
    return found


def survives(mutant: Mutant, file: str, tests: list[str], objects: dict[str, list[str]]) -> bool:
    """No test fails; what does not compile, or runs for ever, is killed."""
    with tempfile.TemporaryDirectory() as folder:
        changed = Path(folder, file)
        changed.write_text(mutant.text, encoding="utf-8")
        part = Path(folder, "mutant.o")
        built = subprocess.run(
            ["gcc", *FLAGS, *WATCHED, "-c", changed, "-o", part],
            capture_output=True,
            timeout=RUN_WITHIN_S,
        )
        if built.returncode != 0:
            return False
        for test in tests:
            name, *arguments = test.split()
            program = Path(folder, name)
            linked = subprocess.run(
                ["gcc", *WATCHED, part, *objects[test], "-o", program, "-lm", "-lpthread", "-lrt"],
                capture_output=True,
                timeout=RUN_WITHIN_S,
            )
            if linked.returncode != 0:
                return False
            try:
                run = subprocess.run(
                    [program, *arguments],
                    capture_output=True,
                    timeout=RUN_WITHIN_S,
                    env={**os.environ, "ASAN_OPTIONS": "detect_leaks=0"},
                )
            except subprocess.TimeoutExpired:
                return False
            if run.returncode != 0:
                return False
    return True


def compiled_rest(name: str, tests: list[str], folder: Path) -> dict[str, list[str]]:
    """Object files of each test and of all other sources."""
    rest = []
    for source in sorted(CSRC.glob("*.c")):
        if source.name != name:
            target = folder / f"{source.stem}.o"
            subprocess.run(["gcc", *FLAGS, "-c", source, "-o", target], check=True, timeout=120)
            rest.append(str(target))
    objects = {}
    for test in tests:
        target = folder / f"{test.split()[0]}.o"
        subprocess.run(
            ["gcc", *FLAGS, *WATCHED, "-c", HERE / f"{test.split()[0]}.c", "-o", target],
            check=True,
            timeout=120,
        )
        objects[test] = [str(target), *rest]
    return objects


def main() -> int:
    parser = argparse.ArgumentParser(description="mutants of a C file against its tests")
    parser.add_argument("file", nargs="?", default="rtu.c")
    parser.add_argument("--tests", default="")
    asked = parser.parse_args()
    tests = asked.tests.split(",") if asked.tests else TESTS[asked.file]
    source = (CSRC / asked.file).read_text(encoding="utf-8")
    known = tomllib.loads((HERE / "mutants.toml").read_text(encoding="utf-8")).get(asked.file, {})
    found = mutants(source)
    print(f"{asked.file}: {len(found)} mutants against {', '.join(tests)}", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        objects = compiled_rest(asked.file, tests, Path(folder))
        alive = [
            mutant
            for mutant, lives in zip(
                found,
                pool.map(lambda m: survives(m, asked.file, tests, objects), found),
                strict=True,
            )
            if lives
        ]
    same = [mutant for mutant in alive if mutant.what in known]
    left = [mutant for mutant in alive if mutant.what not in known]
    for mutant in same:
        print(f"the same program: {mutant} ({known[mutant.what]})")
    for mutant in left:
        print(f"SURVIVED {mutant}")
    print(
        f"{asked.file}: {len(found) - len(alive)} of {len(found)} killed, {len(same)} are the same "
        f"program in other words, {len(left)} survived"
    )
    return int(bool(left))


if __name__ == "__main__":
    sys.exit(main())
