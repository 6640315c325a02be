# SPDX-License-Identifier: Apache-2.0
"""Cycles of bus servos a second, relative to what the wire can carry: motord and the makers' SDKs,
alone in their process and beside a thread that competes for the GIL, with the same servos
(servo_slave.c)."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.bench.fieldbus.wire import ROOT, SLAVE_PRIORITY, compiled

HERE = Path(__file__).parent
BUSES = {"3 STS3215, 1 Mbaud": ("feetech", 1_000_000, 3),
         "6 Dynamixel, 4 Mbaud": ("dynamixel", 4_000_000, 6)}  # fmt: skip
CYCLE_BYTES = {"feetech": (8 + 8, 3 + 1 + 21), "dynamixel": (14 + 14, 5 + 1 + 19)}
"""Bytes of a cycle (sync write of velocities, sync read, replies): shared ones, and per servo."""
MASTERS = {"motord": ("motord", 0), "motord, GIL hog": ("motord", 1),
           "makers' SDK": ("sdk", 0), "makers' SDK, GIL hog": ("sdk", 1)}  # fmt: skip


def limit_hz(kind: str, baudrate: int, servos: int) -> float:
    """Return the cycles a second that the wire can carry if servos answer at once."""
    for_all, for_each = CYCLE_BYTES[kind]
    return baudrate / 10 / (for_all + servos * for_each)


def _one(bus: str, master: str, seconds: float) -> dict[str, Any]:
    kind, baudrate, servos = BUSES[bus]
    who, hogs = MASTERS[master]
    program = compiled("servo_slave")
    assert program is not None, "servo_slave.c does not compile"
    with subprocess.Popen(
        [program, kind, str(baudrate), str(SLAVE_PRIORITY)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    ) as slave:  # fmt: skip
        assert slave.stdin is not None
        assert slave.stdout is not None
        port = slave.stdout.readline().strip()
        command = [sys.executable, str(HERE / "client_servos.py"), who, kind, port, str(baudrate),
                   str(servos), str(hogs)]  # fmt: skip
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
        ) as client:
            assert client.stdin is not None
            assert client.stdout is not None
            assert client.stdout.readline().strip() == "ready"
            _ask(slave)
            time.sleep(seconds)
            found = _ask(slave)
            client.stdin.close()
            client.wait(30)
        slave.stdin.close()
    per_s = found["cycles"] / found["seconds"]
    part = per_s / limit_hz(kind, baudrate, servos)
    return {"per_s": per_s, "part": part, "busy": found["busy"], "bad": found["bad"]}


def _ask(slave: subprocess.Popen[str]) -> dict[str, Any]:
    assert slave.stdin is not None
    assert slave.stdout is not None
    slave.stdin.write("stats\n")
    slave.stdin.flush()
    return dict(json.loads(slave.stdout.readline()))


def measure(rounds: int, seconds: float) -> dict[str, dict[str, Any]]:
    """Return the medians of the rounds, by bus and master."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for _ in range(rounds):
        for bus in BUSES:
            for master in MASTERS:
                rows.setdefault(f"{bus}: {master}", []).append(_one(bus, master, seconds))
    return {
        name: {key: statistics.median(row[key] for row in found) for key in found[0]}
        for name, found in rows.items()
    }


def table(found: dict[str, dict[str, Any]]) -> str:
    head = f"{'bus servos':44} cycles/s  of the wire's limit  wire busy"
    rows = [
        f"{name:44} {row['per_s']:8.1f} {100 * row['part']:19.1f} % {100 * row['busy']:8.1f} %"
        for name, row in found.items()
    ]
    return "\n".join([head, *rows])


def verdicts(found: dict[str, dict[str, Any]]) -> list[tuple[str, bool, bool]]:
    """Return verdicts as `wire.verdicts` does. `busy` includes what motord reads beside a cycle."""
    verdicts = []
    for bus in BUSES:
        ours, theirs = found[f"{bus}: motord, GIL hog"], found[f"{bus}: makers' SDK, GIL hog"]
        ratio = ours["per_s"] / max(theirs["per_s"], 1e-9)
        text = f"{bus}, beside a GIL hog: {ratio:.1f} times the cycles of the maker's SDK (2)"
        verdicts.append((text, ratio >= 2.0, False))
    return verdicts
