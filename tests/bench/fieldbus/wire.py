# SPDX-License-Identifier: Apache-2.0
"""Measures how much of the wire each master uses, and whether it keeps the silent interval: all
masters with the same slave (rtu_slave.c), one after the other in each round."""

from __future__ import annotations

import contextlib
import json
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
BUILD = ROOT / "build/bench"
SPEC_GAP_US, SHORT_GAP_US = 1750.0, 3.5 * 10 / 115200 * 1e6
SLAVE_PRIORITY = 60
READY_WITHIN_S = 30.0


@dataclass(frozen=True)
class Arm:
    """One master in one situation."""

    name: str
    command: tuple[str, ...]
    gap_us: float = SPEC_GAP_US
    ours: bool = False


@dataclass
class Result:
    rounds: list[dict[str, Any]] = field(default_factory=list)

    def median(self, key: str) -> float:
        return statistics.median(row[key] for row in self.rounds)

    def total(self, key: str) -> int:
        return sum(row[key] for row in self.rounds)


def compiled(name: str, *flags: str) -> str | None:
    """Compile NAME.c; return the program, or None if it cannot be built (a library is missing)."""
    BUILD.mkdir(parents=True, exist_ok=True)
    program = BUILD / name
    run = subprocess.run(
        ["gcc", "-std=c11", "-D_GNU_SOURCE", "-O2", "-o", program, HERE / f"{name}.c", *flags],
        capture_output=True,
        timeout=120,
    )
    return str(program) if run.returncode == 0 else None


class Slave:
    """A running rtu_slave."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._to, self._from = process.stdin, process.stdout
        self.port = self._from.readline().strip()

    def ask(self, what: str) -> dict[str, Any]:
        """Return the answer to "stats": the counters, which then restart at zero; or to "changed":
        when the first request came that changed a register since the last "changed"."""
        self._to.write(f"{what}\n")
        self._to.flush()
        return dict(json.loads(self._from.readline()))


@contextlib.contextmanager
def slave(gap_us: float) -> Iterator[Slave]:
    """Run a slave that answers for all units, with the timing of a wire of 115200 baud."""
    program = compiled("rtu_slave")
    assert program is not None, "rtu_slave.c does not compile"
    with subprocess.Popen(
        [program, "115200", str(gap_us), str(SLAVE_PRIORITY)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        try:
            yield Slave(process)
        finally:
            process.stdin.close()
            process.wait(10)


def arms() -> list[Arm]:
    """Return motord in all situations, and the other masters in their usual one."""
    here = sys.executable
    ours = str(HERE / "client_motord.py")
    others = str(HERE / "client_rivals.py")
    found = [
        *(Arm(f"motord, {n} drive{'s'[:n > 1]}", (here, ours, "PORT", str(n), "spec", "16", "0"),
              ours=True) for n in (1, 2, 4)),
        *(Arm(f"motord, {n} drive{'s'[:n > 1]}, GIL hog",
              (here, ours, "PORT", str(n), "spec", "16", "1"), ours=True) for n in (1, 2, 4)),
        Arm("motord, 2 drives, function 23, 3.5 characters",
            (here, ours, "PORT", "2", "3.5char", "23", "0"), SHORT_GAP_US, ours=True),
        *(Arm(kind, (here, others, kind, "PORT", "SECONDS", "0"))
          for kind in ("minimalmodbus", "pymodbus-sync", "pymodbus-async")),
        *(Arm(f"{kind}, GIL hog", (here, others, kind, "PORT", "SECONDS", "1"))
          for kind in ("minimalmodbus", "pymodbus-async")),
    ]  # fmt: skip
    if (libmodbus := compiled("client_libmodbus", "-I/usr/include/modbus", "-lmodbus")) is not None:
        found.append(Arm("libmodbus", (libmodbus, "PORT", "SECONDS")))
    return found


def one_round(arm: Arm, seconds: float) -> dict[str, Any]:
    """Run slave and master from start to end; return the slave's figures and the master's CPU."""
    with slave(arm.gap_us) as judge:
        command = [
            {"PORT": judge.port, "SECONDS": str(seconds)}.get(word, word) for word in arm.command
        ]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
        ) as client:
            assert client.stdin is not None
            assert client.stdout is not None
            if not arm.ours:
                client.stdin.close()
                found = json.loads(client.stdout.readline())
                transactions, cpu_ns = found["transactions"], found["cpu_ns"]
            else:
                assert client.stdout.readline().strip() == "ready"
                before = _ask(client)
                judge.ask("stats")
                time.sleep(seconds)
                judged = judge.ask("stats")
                after = _ask(client)
                client.stdin.close()
                transactions = after["exchanges"] - before["exchanges"]
                cpu_ns = after["cpu_ns"] - before["cpu_ns"]
            client.wait(READY_WITHIN_S)
        judged = judged if arm.ours else judge.ask("stats")
    return judged | {"cpu_us": cpu_ns / 1e3 / max(transactions, 1)}


def _ask(client: subprocess.Popen[str]) -> dict[str, Any]:
    assert client.stdin is not None
    assert client.stdout is not None
    client.stdin.write("stats\n")
    client.stdin.flush()
    return dict(json.loads(client.stdout.readline()))


def measure(rounds: int, seconds: float, chosen: Sequence[Arm] | None = None) -> dict[str, Result]:
    """Run every arm in every round, so that a bad moment of the machine affects all of them."""
    chosen = arms() if chosen is None else chosen
    results = {arm.name: Result() for arm in chosen}
    for number in range(rounds):
        for arm in chosen if number % 2 == 0 else reversed(chosen):
            print(f"  round {number + 1} of {rounds}: {arm.name}", file=sys.stderr, flush=True)
            results[arm.name].rounds.append(one_round(arm, seconds))
    return results


def table(results: dict[str, Result]) -> str:
    """Return the medians of the rounds as text; counts are sums."""
    rows = [f"{'':46} of the wire (p50, all)   per s   CPU µs  violations  excused"]
    for name, result in results.items():
        rows.append(
            f"{name:46} {100 * result.median('fraction_p50'):8.1f} %"
            f" {100 * result.median('throughput'):8.1f} % {result.median('per_s'):8.1f}"
            f" {result.median('cpu_us'):8.1f} {result.total('violations'):7} of"
            f" {result.total('requests')} {result.total('excused'):4}"
        )
    return "\n".join(rows)


def verdicts(results: dict[str, Result]) -> list[tuple[str, bool, bool]]:
    """Return (sentence, reached, whether it is about correctness and not speed) for each goal."""
    ours = {name: result for name, result in results.items() if name.startswith("motord")}
    spec = {name: found for name, found in ours.items() if "23" not in name}
    least = min(found.median("fraction_p50") for found in spec.values())
    violations = sum(found.total("violations") for found in ours.values())
    cpu = max(found.median("cpu_us") for found in spec.values())
    ratio = cpu / results["minimalmodbus"].median("cpu_us")
    short = next(found for name, found in ours.items() if "23" in name)
    per_drive, part = short.median("per_s") / 2, short.median("fraction_p50")
    short_text = (
        f"function 23 at 3.5 characters, two drives: {per_drive:.0f} Hz a drive (125), "
        f"{100 * part:.1f} % of that wire (95)"
    )
    return [
        (f"at least 96 % of the wire by p50 in every situation: {100 * least:.1f} %", least >= 0.96,
         False),
        (f"no violation of the silent interval: {violations}", violations == 0, True),
        (f"CPU at most half of minimalmodbus': {ratio:.2f}", ratio <= 0.5, False),
        (short_text, per_drive >= 125 and part >= 0.95, False),
    ]  # fmt: skip


def has_bench_tools() -> list[str]:
    """Return what the whole comparison lacks on this machine, as sentences."""
    missing = []
    if shutil.which("gcc") is None:
        missing.append("gcc is missing: apt install gcc")
    if compiled("client_libmodbus", "-I/usr/include/modbus", "-lmodbus") is None:
        missing.append("libmodbus is left out: apt install libmodbus-dev")
    return missing
