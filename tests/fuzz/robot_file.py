# SPDX-License-Identifier: Apache-2.0
"""Mutated robot files: the reader reports its findings, or returns a robot. It never ends in a
traceback, and its time and memory are bounded."""

from __future__ import annotations

import contextlib
import random
import re
import resource
import signal
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

from mutate import mutated

from motord.config import ConfigError, load_robot

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted((ROOT / "config/robots").glob("*.toml"))
DEADLINE_S = 30
"""A file takes some 20 ms. Only a reader that hangs reaches this, even on a busy machine."""
MEMORY_BYTES = 1 << 30
"""The reader may take this much more than the process has at its start."""
WORDS = (
    b"nan", b"-inf", b"1e400", b"-1", b"0", b"0x7fffffffffffffff", b"9" * 400, b"9" * 5000,
    b"true", b'""', b"[]", b"{}", b"[[1], {a = 1}]", b'"\\u0000"', b"'''", b'"""', b"\xff\xfe",
    b"1979-05-27T07:32:00Z", b"\n[[line]]\n", b"\n[joint]\n", b"\n[line.rs485]\n", b".a" * 200,
    b"[" * 300, b"{a=" * 200, b"x" * 70_000, b"\n" * 2000, b"\\N", b"\x00", b"# ", b"= ", b"]",
)  # fmt: skip


class _TooSlow(BaseException):
    """Time-out of the reader. It is not an Exception, so no handler of errors catches it."""


def run(seed: int, runs: int) -> Iterator[tuple[str, bytes]]:
    """Yield each problem with its input."""
    dice = random.Random(seed)
    originals = [path.read_bytes() for path in SHIPPED]
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, _bounded_memory():
        for _ in range(runs):
            data = _variant(dice, originals)
            problem = _try(Path(folder) / "robot.toml", data)
            if problem:
                yield problem, data


def _variant(dice: random.Random, originals: Sequence[bytes]) -> bytes:
    data = dice.choice(originals)
    rows = data.splitlines(keepends=True)
    match dice.randrange(4):
        case 0:  # bytes anywhere
            return mutated(dice, data, WORDS)
        case 1:  # another value
            return b"".join(_revalued(dice, rows))
        case 2:  # other rows, also of other files
            more = dice.choice(originals).splitlines(keepends=True)
            begin, end = sorted(dice.randint(0, len(more)) for _ in range(2))
            place = dice.randint(0, len(rows))
            return b"".join(rows[:place] + more[begin:end] + rows[dice.randint(0, len(rows)) :])
        case _:  # another key
            place = dice.randrange(len(rows))
            rows[place] = mutated(dice, rows[place], WORDS)
            return b"".join(rows)


def _revalued(dice: random.Random, rows: list[bytes]) -> list[bytes]:
    values = [number for number, row in enumerate(rows) if re.match(rb"[\w.]+ *=", row)]
    for number in dice.sample(values, min(len(values), dice.randint(1, 3))):
        key = rows[number].partition(b"=")[0]
        rows[number] = key + b"= " + dice.choice(WORDS) + b"\n"
    return rows


def _try(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    signal.signal(signal.SIGALRM, _too_slow)
    signal.alarm(DEADLINE_S)
    try:
        return _read(path)
    except _TooSlow:
        return f"it takes longer than {DEADLINE_S} s"
    except Exception as error:  # noqa: BLE001  # any exception is a finding
        return f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)


def _read(path: Path) -> str:
    try:
        robot = load_robot(path)
        problems = [str(warning) for warning in robot.warnings]
    except ConfigError as error:
        problems = [str(problem) for problem in error.problems]
        if not problems:
            return "an error without a text"
    several = [text for text in problems if len(text.splitlines()) != 1]
    return f"a finding that is not one line: {several[0]!r}" if several else ""


def _too_slow(number: int, frame: FrameType | None) -> None:
    raise _TooSlow


@contextlib.contextmanager
def _bounded_memory() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
