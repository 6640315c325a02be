# SPDX-License-Identifier: Apache-2.0
"""Time from a command's datagram to its first byte on the wire, with and without busy Python in the
daemon: the real daemon, its real-time line, and a slave that reports when the bytes came."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from tests.bench.fieldbus.wire import ROOT, SPEC_GAP_US, slave

from motord.api.commands import datagram
from motord.client import Client, ClientError

PAUSE_S = (0.11, 0.14)
"""Range of the pause after a command, in which the line gets idle: no queue is measured."""
WITHIN_S = 30.0
HOGGED = Path(__file__).with_name("hogged.py")
PROFILE = ROOT / "tests/bench/fieldbus/bench-drive.toml"
ROBOT = """
[robot]
name = "{name}"

[base]
kind = "differential"
track_m = 0.4
wheel_radius_m = 0.05

[limits]
linear_m_s = 1.0
linear_m_s2 = 100.0

[safety]
command_timeout_s = 2.0
feedback_timeout_s = 2.0
heartbeat_timeout_s = 5.0
timeout_travel_max_m = 1000.0

[safety.feedback]  # the slave is not a wheel: its position does not change
direction_s = 0.0
stall_s = 0.0
following_s = 0.0
runaway_s = 0.0
implausible_s = 0.0
jumps_max = 0

[line.bench]
kind = "modbus-rtu"
port = "{port}"
engine = "rt"
echo = "no"
cycle_hz = 2.0

[joint.left]
line = "bench"
drive = "{profile}"
unit = 1
channel = 1
side = "left"

[joint.right]
line = "bench"
drive = "{profile}"
unit = 1
channel = 2
side = "right"

[input.socket]
kind = "socket"

[input.bench]
kind = "rt"
priority = 200
lease_s = 2.0
"""


@contextlib.contextmanager
def daemon(
    folder: Path, port: str, hogs: int, more: str = "", *, begin: bool = True
) -> Iterator[Client]:
    """Run the daemon, armed. `more`: sections for its robot file; `begin`: start its hogs now."""
    robot = folder / "robot.toml"
    name = f"bench{uuid.uuid4().hex[:8]}"
    text = ROBOT.format(name=name, port=port, profile=PROFILE) + more
    robot.write_text(text, encoding="utf-8")
    path = folder / f"d{hogs}.sock"
    process = subprocess.Popen(
        [sys.executable, HOGGED, "run", robot, "--socket", path],
        stdout=subprocess.DEVNULL, stderr=(folder / "daemon.log").open("wb"), cwd=ROOT,
        env={**os.environ, "HOGS": str(hogs)},
    )  # fmt: skip
    try:
        with _connected(path) as robot_client:
            _until(lambda: robot_client.status()["state"] == "idle", "idle")
            _until(robot_client.arm, "arming")
            if begin:
                process.send_signal(signal.SIGUSR1)
            yield robot_client
    finally:
        process.terminate()
        try:
            process.wait(WITHIN_S)
        finally:
            process.kill()


def _until(condition, what):  # type: ignore[no-untyped-def]  # a bench's helper
    end_s = time.monotonic() + WITHIN_S
    while True:
        with contextlib.suppress(ClientError):
            if found := condition():
                return found
        assert time.monotonic() < end_s, f"no {what} within {WITHIN_S} s"
        time.sleep(0.05)


def _connected(path: Path) -> Client:
    return _until(lambda: Client(path), "socket")


def delays_us(hogs: int, count: int, seed: int = 7) -> list[float]:
    """Return the delays of `count` commands at irregular times, each with a changed speed."""
    chance = random.Random(seed)
    found = []
    with (
        tempfile.TemporaryDirectory() as made,
        slave(SPEC_GAP_US) as judge,
        daemon(Path(made), judge.port, hogs) as robot,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as commands,
    ):
        lease = _until(lambda: robot.call("lease", owner="bench"), "lease")
        commands.connect(lease["socket"])
        token = bytes.fromhex(lease["token"])
        with contextlib.suppress(PermissionError, OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
        try:
            for sequence in range(1, count + 1):
                speed_m_s = 0.3 if sequence % 2 else 0.6
                judge.ask("changed")
                given_ns = time.monotonic_ns()
                commands.send(datagram(token, sequence, given_ns, speed_m_s, 0.0))
                time.sleep(chance.uniform(*PAUSE_S))
                found.append((given_ns, judge.ask("changed")["changed_ns"]))
        finally:
            with contextlib.suppress(PermissionError, OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return [(came_ns - given_ns) / 1e3 for given_ns, came_ns in found if came_ns > given_ns]


def percentile(values: list[float], fraction: float) -> float:
    ordered = sorted(values)
    return ordered[round((len(ordered) - 1) * fraction)]


def measure(count: int, hogs: int = 4) -> dict[str, dict[str, float]]:
    """Return the figures without and with hogs, which are measured in turns."""
    pools: dict[int, list[float]] = {0: [], hogs: []}
    for part, number in enumerate((0, hogs, hogs, 0)):
        print(f"  part {part + 1} of 4: {number} hogs", file=sys.stderr, flush=True)
        pools[number] += delays_us(number, count // 2, seed=part)
    return {
        name: {"p50_us": percentile(pool, 0.5), "p90_us": percentile(pool, 0.9),
               "p99_us": percentile(pool, 0.99), "samples": len(pool)}
        for name, pool in (("idle", pools[0]), ("hogged", pools[hogs]))
    }  # fmt: skip


def verdicts(found: dict[str, dict[str, float]]) -> list[tuple[str, bool, bool]]:
    """Return the verdicts as `wire.verdicts` does."""
    p50_us, p90_us = found["hogged"]["p50_us"], found["hogged"]["p90_us"]
    ratio = p50_us / found["idle"]["p50_us"]
    return [
        (f"datagram to byte with 4 hogs: p50 {p50_us:.0f} µs (200), p90 {p90_us:.0f} µs (300)",
         p50_us <= 200 and p90_us <= 300, False),
        (f"and {ratio:.2f} times its idle value (1.5)", ratio <= 1.5, False),
    ]  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]) if len(sys.argv) > 1 else 100), indent=1))
