# SPDX-License-Identifier: Apache-2.0
"""Check the C tests with mutants. A mutant is a C file with one small error in it; tests that pass
with it do not find the error.

python tests/c/mutants.py [FILE ...] [--sample N] [--seed S] [--jobs N] [--again]

Without FILE: all files of `code_files`. With --again: only the mutants that survived the last run
of their file.

The tests are linked once against a library of csrc/. A mutant is a small shared object that is
loaded before that library and takes the place of its functions. The tests run it without
sanitizers; if it survives, they run once more with sanitizers. A mutant does not count if it does
not compile, or if its optimized machine code equals that of the unchanged file.

The exit status is 1 if a mutant survives that mutants.toml does not list, or if mutants.toml lists
one that the tests kill or that does not exist. mutants.toml lists the mutants that are the same
program in other words.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from queue import SimpleQueue
from threading import Lock

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
CSRC = ROOT / "csrc"
BUILT = ROOT / "build/mutants"
PLAIN = ["-O1"]
FLAGS = ["-std=c11", "-D_GNU_SOURCE", "-ffp-contract=off", "-w"]
CHECKS = ["-fsanitize=address,undefined,bounds-strict", "-fno-sanitize-recover=all"]
SANITIZED = ["-O1", *CHECKS]
CHECKED = ["-O0", *CHECKS, "-fPIC", "-shared"]  # for mutants: compiles three times as fast
FUZZ = ["fuzz_line 2000", "fuzz_can 2000", "fuzz_board 3000", "fuzz_command 20000"]
BLOCKED_AFTER_S = 20.0
CPU_LEAST_S = 0.1
CPU_FACTOR = 8
SANITIZED_FACTOR = 10

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
_COMMENT = re.compile(r"/\*.*?(?:\*/|$)", re.DOTALL)

# Ends a mutant in an endless loop by a limit on its CPU time, which a busy machine does not change.
DEADLINE = """
#include <stdlib.h>
#include <sys/time.h>
__attribute__((constructor)) static void set_deadline(void)
{
    const char *cpu_us = getenv("MUTANT_CPU_US");
    struct itimerval limit = {.it_value.tv_usec = cpu_us != NULL ? atol(cpu_us) : 0};
    limit.it_value.tv_sec = limit.it_value.tv_usec / 1000000;
    limit.it_value.tv_usec %= 1000000;
    setitimer(ITIMER_PROF, &limit, NULL);
}
"""
# Is loaded with an instrumented file: a test that calls a function of it exits with CALLED_STATUS.
CALLED_STATUS = 99
CALLED = f"""
#include <unistd.h>
__attribute__((no_instrument_function)) void __cyg_profile_func_enter(void *callee, void *caller)
{{
    (void)callee, (void)caller;
    _exit({CALLED_STATUS});
}}
"""


@dataclass(frozen=True)
class Mutant:
    line: int
    what: str  # the changed line without comments, with the change in double braces
    text: str


def _pieces(source: str) -> Iterator[tuple[int, int, str, str]]:
    """Yield (begin, end, kind, text) of each changeable piece: statements, and their parts, too."""
    for found in _TOKEN.finditer(source):
        kind = found.lastgroup or "skip"
        if kind == "skip":
            continue
        lead = len(found.group()) - len(found.group().lstrip())
        yield found.start() + lead, found.end(), kind, found.group().strip()
        if kind == "statement":
            for inner in _TOKEN.finditer(found.group().lstrip().replace("\n", " ")):
                if inner.lastgroup in ("number", "op"):
                    shift = found.start() + lead
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
        return [f"{other:0{width}}{suffix}" for other in near]  # keeps the zero of 0.01
    # a statement is removed, but not a return: the value of the function would be undefined
    return [] if text.startswith("return") else [";"]


def mutants(source: str) -> list[Mutant]:
    """Return all mutants of `source`, in the order of the places that they change."""
    found = []
    seen: Counter[str] = Counter()
    for begin, end, kind, text in _pieces(source):
        for new in _changes(kind, text):
            start = source.rfind("\n", 0, begin) + 1
            stop = source.find("\n", end)
            change = "removed" if kind == "statement" else new or "nothing"
            shown = f"{source[start:begin]}{{{{{text} -> {change}}}}}{source[end:stop]}"
            shown = " ".join(_COMMENT.sub("", shown).split())
            seen[shown] += 1
            what = shown if seen[shown] == 1 else f"{shown} ({seen[shown]})"
            line = source.count("\n", 0, begin) + 1
            found.append(Mutant(line, what, source[:begin] + new + source[end:]))
    return found


def compile_all(arguments: list[str | Path], into: Path, needs: list[Path]) -> None:
    """Compile and link into the file `into`, if it is missing or a file of `needs` is newer."""
    if into.exists() and into.stat().st_mtime > max(path.stat().st_mtime for path in needs):
        return
    fresh = into.with_name(f"{into.name}.{os.getpid()}")
    subprocess.run(["gcc", *FLAGS, *arguments, "-o", fresh], check=True, timeout=300)
    fresh.replace(into)


def write_if_other(path: Path, text: str) -> None:
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


@dataclass
class Program:
    """A test program, or a fuzzer with its arguments, and what it did to the mutants of a file."""

    call: str
    cpu_s: float = 0.0
    kills: int = 0
    lock: Lock = field(default_factory=Lock)

    def command(self, flags: list[str]) -> list[str]:
        """Return the command that runs the program; build the program first if needed."""
        name, *arguments = self.call.split()
        into = BUILT / (f"{name}.sanitized" if flags is SANITIZED else name)
        own = sorted(HERE.rglob("*.h"))
        needs = [*own, *(BUILT / "csrc").glob("*.h"), *ROOT.glob("docs/mcu/*.[ch]")]
        (source,) = HERE.glob(f"*/{name}.c")
        folders = [f"-I{folder}" for folder in (BUILT / "csrc", *{path.parent for path in own})]
        here: list[str | Path] = [source, *folders, BUILT / "libcsrc.so"]
        with self.lock:
            compile_all(
                [*flags, *here, f"-Wl,-rpath,{BUILT}", "-lm", "-lpthread", "-lrt"],
                into,
                [source, *needs],
            )
        return [str(into), *arguments]

    @property
    def limit_s(self) -> float:
        return max(CPU_LEAST_S, CPU_FACTOR * self.cpu_s)

    @property
    def order(self) -> float:
        """Sort key: the program that kills most mutants for its CPU time has the smallest."""
        return self.cpu_s / (1 + self.kills)


def flat(path: Path) -> str:
    """Return a file's text with bare names in includes and all symbols visible: replaceable."""
    text = path.read_text(encoding="utf-8").replace("#pragma GCC visibility", "#pragma")
    return re.sub(r'^#include "(?:\w+/)+', '#include "', text, flags=re.MULTILINE)


class Bench:
    """The test programs, each linked once, and a copy of csrc/ for each worker to change."""

    def __init__(self, folder: Path, jobs: int) -> None:
        self.folder = folder
        self.pool = ThreadPoolExecutor(jobs)
        asan = ["gcc", "-print-file-name=libasan.so"]
        self.asan = subprocess.run(asan, check=True, capture_output=True, text=True).stdout.strip()
        (BUILT / "csrc").mkdir(parents=True, exist_ok=True)
        for path in sorted(CSRC.rglob("*.[ch]")):
            write_if_other(BUILT / "csrc" / path.name, flat(path))
        self._build_library()
        self.programs = self._programs()
        self.copies: SimpleQueue[Path] = SimpleQueue()
        for number in range(jobs):
            self.copies.put(Path(shutil.copytree(BUILT / "csrc", folder / f"csrc{number}")))

    def _build_library(self) -> None:
        write_if_other(BUILT / "deadline.c", DEADLINE)
        write_if_other(BUILT / "called.c", CALLED)
        headers = list((BUILT / "csrc").glob("*.h"))
        sources = [BUILT / "csrc" / path.name for path in sorted(CSRC.rglob("*.c"))]
        sources.append(BUILT / "deadline.c")
        objects = [BUILT / f"{source.stem}.o" for source in sources]

        def compile_one(source: Path, into: Path) -> None:
            compile_all(["-O1", "-fPIC", "-c", source], into, [source, *headers])

        list(self.pool.map(compile_one, sources, objects))
        compile_all(
            ["-shared", *objects, "-lm", "-lpthread", "-lrt"], BUILT / "libcsrc.so", objects
        )

    def _programs(self) -> list[Program]:
        listed = subprocess.run(
            ["make", "-s", "--no-print-directory", "-C", HERE, "print-tests"],
            check=True, capture_output=True, text=True,
        ).stdout.split()  # fmt: skip
        programs = [Program(call) for call in [*listed, *FUZZ]]
        list(self.pool.map(lambda program: program.command(PLAIN), programs))
        return programs

    def includers(self, name: str) -> list[str]:
        """Return the C files that have to be compiled again when the file `name` changes."""
        if name.endswith(".c"):
            return [name]
        reached, left = {name}, [name]
        while left:
            wanted = f'#include "{left.pop()}"'
            for path in sorted(CSRC.rglob("*.[ch]")):
                if path.name not in reached and wanted in flat(path):
                    reached.add(path.name)
                    left.append(path.name)
        return sorted(path for path in reached if path.endswith(".c"))

    def build(self, copy: Path, parts: list[str], flags: list[str], into: Path) -> bool:
        """Compile `parts` of `copy` into the file `into`; return whether the compiler succeeded."""
        arguments = [*FLAGS, *flags, *(str(copy / part) for part in parts)]
        done = subprocess.run(
            ["gcc", *arguments, "-o", into], stderr=subprocess.DEVNULL, timeout=300
        )
        return done.returncode == 0

    def run(self, command: list[str], preload: str, limit_s: float) -> int:
        # Limits go through the environment: preexec_fn would run Python in a child of a thread.
        environment = {
            "LD_PRELOAD": preload,
            "ASAN_OPTIONS": "detect_leaks=0",
            "MUTANT_CPU_US": str(round(limit_s * 1e6)),
        }
        try:
            return subprocess.run(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                close_fds=False,
                timeout=BLOCKED_AFTER_S,
            ).returncode
        except subprocess.TimeoutExpired:
            return -1


@dataclass
class Tally:
    """Results of the mutants of a file."""

    name: str
    count: int = 0
    killed: int = 0
    same: list[Mutant] = field(default_factory=list)
    left: list[Mutant] = field(default_factory=list)
    stale: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def row(self) -> str:
        survived = len(self.left)
        return (
            f"{self.name:18}{self.count:8}{self.killed:8}{len(self.same):8}{survived:10}"
            f"{self.seconds:9.1f}"
        )


class Trial:
    """The mutants of one file, and the tests that call functions of that file."""

    def __init__(self, bench: Bench, name: str) -> None:
        self.bench = bench
        self.name = name
        self.parts = bench.includers(name)
        self.tests: list[Program] = []
        self.code = b""

    def prepare(self) -> None:
        copy = self.bench.copies.get()
        called, same = self.bench.folder / "called.so", self.bench.folder / "same.so"
        shared = ["-O0", "-fPIC", "-shared"]
        hook = str(BUILT / "called.c")
        instrumented = [*shared, "-finstrument-functions", hook]
        assert self.bench.build(copy, self.parts, instrumented, called)
        assert self.bench.build(copy, self.parts, shared, same)
        checked = self.bench.folder / "checked.so"
        assert self.bench.build(copy, self.parts, CHECKED, checked)
        self.code = self._code(copy)
        self.bench.copies.put(copy)

        def calls(program: Program) -> bool:
            command = program.command(PLAIN)
            if self.bench.run(command, str(called), BLOCKED_AFTER_S) != CALLED_STATUS:
                return False
            program.command(SANITIZED)
            return True

        callers = list(self.bench.pool.map(calls, self.bench.programs))
        for program in compress(self.bench.programs, callers):
            command = program.command(PLAIN)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            if self.bench.run(command, str(same), BLOCKED_AFTER_S) != 0:
                sys.exit(f"{program.call} fails without a mutant of {self.name}")
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            self.tests.append(Program(program.call, cpu_s, lock=program.lock))
            preload = f"{self.bench.asan}:{checked}"
            if self.bench.run(program.command(SANITIZED), preload, BLOCKED_AFTER_S) != 0:
                sys.exit(f"{program.call} fails with sanitizers, without a mutant of {self.name}")

    def _code(self, copy: Path) -> bytes:
        """Return the optimized machine code; empty if a part does not compile."""
        code = b""
        into = copy / "code.o"
        for part in self.parts:
            if not self.bench.build(copy, [part], ["-O2", "-c"], into):
                return b""
            code += into.read_bytes()
        return code

    def _survives(self, copy: Path) -> bool | None:
        """Return None if the mutant does not compile or has the same machine code as the file."""
        shared = copy / "mutant.so"
        if not self.bench.build(copy, self.parts, ["-O0", "-fPIC", "-shared"], shared):
            return None
        for test in sorted(self.tests, key=lambda program: program.order):
            if self.bench.run(test.command(PLAIN), str(shared), test.limit_s) != 0:
                test.kills += 1
                return False
        if self._code(copy) == self.code:
            return None
        if not self.bench.build(copy, self.parts, CHECKED, shared):
            return None
        preload = f"{self.bench.asan}:{shared}"
        return all(
            self.bench.run(test.command(SANITIZED), preload, SANITIZED_FACTOR * test.limit_s) == 0
            for test in self.tests
        )

    def survives(self, mutant: Mutant) -> bool | None:
        copy = self.bench.copies.get()
        path = copy / self.name
        whole = path.read_text(encoding="utf-8")
        try:
            path.write_text(mutant.text, encoding="utf-8")
            return self._survives(copy)
        finally:
            path.write_text(whole, encoding="utf-8")
            self.bench.copies.put(copy)

    def judge(self, known: dict[str, str], sample: int, seed: int, again: bool) -> Tally:
        began_s = time.monotonic()
        self.prepare()
        whole = (BUILT / "csrc" / self.name).read_text(encoding="utf-8")
        found = mutants(whole)
        whats = {mutant.what for mutant in found}
        left = BUILT / f"{self.name}.left"
        if again and left.exists():
            names = set(left.read_text(encoding="utf-8").splitlines())
            found = [mutant for mutant in found if mutant.what in names]
        if 0 < sample < len(found):
            found = random.Random(seed).sample(found, sample)
        tally = Tally(self.name)
        tally.stale = [what for what in known if what not in whats]
        fates = self.bench.pool.map(self.survives, found)
        for mutant, survives in zip(found, fates, strict=True):
            if survives is None:
                continue
            tally.count += 1
            if not survives:
                tally.killed += 1
                tally.stale += [mutant.what] if mutant.what in known else []
            elif mutant.what in known:
                tally.same.append(mutant)
            else:
                tally.left.append(mutant)
                print(f"SURVIVED {self.name}:{mutant.line}: {mutant.what}", flush=True)
        if sample == 0:
            left.write_text("".join(f"{mutant.what}\n" for mutant in tally.left), encoding="utf-8")
        tally.seconds = time.monotonic() - began_s
        return tally


def code_files() -> list[str]:
    """Return all C files, and headers with functions."""
    headers = [
        path.name
        for path in sorted(CSRC.rglob("*.h"))
        if "static inline" in path.read_text(encoding="utf-8")
    ]
    return [path.name for path in sorted(CSRC.rglob("*.c"))] + headers


def main() -> int:
    parser = argparse.ArgumentParser(description="mutants of C files against their tests")
    parser.add_argument("file", nargs="*")
    parser.add_argument("--sample", type=int, default=0, help="so many of each file, not all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--again", action="store_true", help="only what survived the last run")
    asked = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    listed = tomllib.loads((HERE / "mutants.toml").read_text(encoding="utf-8"))
    tallies = []
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), asked.jobs)
        for name in asked.file or code_files():
            known = listed.get(name, {})
            tally = Trial(bench, name).judge(known, asked.sample, asked.seed, asked.again)
            tallies.append(tally)
            for what in tally.stale:
                print(f"STALE {name}: {what}: mutants.toml argues, but the tests kill it"
                      " or it is not there")  # fmt: skip
            print(f"{tally.row().strip()}", file=sys.stderr, flush=True)
    total = Tally("all", *(sum(getattr(t, name) for t in tallies) for name in ("count", "killed")))
    for tally in tallies:
        total.same += tally.same
        total.left += tally.left
        total.seconds += tally.seconds
    print("file               mutants  killed  argued  survived  seconds")
    for tally in [*tallies, total]:
        print(tally.row())
    return int(any(tally.left or tally.stale for tally in tallies))


if __name__ == "__main__":
    sys.exit(main())
