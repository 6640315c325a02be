# SPDX-License-Identifier: Apache-2.0
"""The effect on loop and lines when motord-bus or its readers are stopped, killed or leak: one
daemon, alternating calm and disturbed windows; ratios are medians of the pairs.

python -m tests.bench.bus.disturbed: one JSON object.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from tests.bench.bus import bus_at_work
from tests.bench.loop import lateness
from tests.sim.daemon_stage import ROOT, wait_until
from tests.sim.planted import Planted

PEER = "tests.peers.ros2.ros2_peer"
BACK_WITHIN_S = 60.0
READER = """
import contextlib, json, socket, sys
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

def read():
    wire = socket.socket()
    wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)  # soon full
    wire.connect(("127.0.0.1", int(sys.argv[1])))
    with connect("ws://localhost/", sock=wire, max_size=None, ping_interval=None) as bus:
        for topic in ("odom", "tf", "joint_states", "motor_status"):
            bus.send(json.dumps({"op": "subscribe", "topic": f"/{topic}"}))
        print("ready", flush=True)
        for _ in bus:
            pass

while True:  # a reader that was stopped for too long is disconnected, and reconnects
    with contextlib.suppress(ConnectionClosed, TimeoutError):
        read()
"""
Disturbance = Callable[[], AbstractContextManager[None]]
Figures = dict[str, float]


# ---------------------------------------------------------------------------------------- a window
def counted(status: dict[str, Any]) -> Figures:
    lines = status["lines"].values()
    return {
        "ticks": status["loop"]["ticks"],
        "overruns": status["loop"]["overruns"],
        "page_faults": status["loop"]["page_faults"],
        "exchanges": sum(line["exchanges"] for line in lines),
        "errors": sum(sum(line["errors"].values()) for line in lines),
    }


def window(made: Any, seconds: float) -> Figures:
    """Return the lateness of all ticks in a window, the counts, and exchanges per tick."""

    def look() -> tuple[dict[tuple[int, int], int], Figures]:
        bars = made.robot.latency()["buckets"]["lateness"]
        return {low: (high, n) for low, high, n in bars}, counted(made.robot.status())

    bars_before, before = look()
    time.sleep(seconds)
    bars_after, after = look()
    grown = [
        ((low + high) / 2, n - bars_before.get(low, (0, 0))[1])
        for low, (high, n) in bars_after.items()
    ]
    found = {key: after[key] - before[key] for key in after}
    late = lateness.figures(grown)
    found |= {"p50_us": late["p50_us"], "p99_us": late["p99_us"]}
    return found | {"exchanges_per_tick": found["exchanges"] / found["ticks"]}


def pairs(made: Any, disturbance: Disturbance, count: int, seconds: float) -> dict[str, Any]:
    """Alternate calm and disturbed windows. Counts are sums, other figures medians; `ratio` has the
    medians of disturbed divided by calm of each pair."""
    rows: list[tuple[Figures, Figures]] = []
    for _ in range(count):
        calm = window(made, seconds)
        with disturbance():
            rows.append((calm, window(made, seconds)))
    found: dict[str, Any] = {}
    for place, name in enumerate(("calm", "disturbed")):
        found[name] = {
            key: (sum if key in COUNTS else statistics.median)(row[place][key] for row in rows)
            for key in rows[0][place]
        }
    found["ratio"] = {
        key: statistics.median(disturbed[key] / calm[key] for calm, disturbed in rows)
        for key in ("p50_us", "p99_us", "exchanges_per_tick")
    }
    return found


COUNTS = ("ticks", "overruns", "page_faults", "exchanges", "errors")


# ---------------------------------------------------------------------------------- a stuck reader
@contextlib.contextmanager
def reader(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a reader and yield it once it has begun to read; read its output meanwhile."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    try:
        assert process.stdout.readline(), "the reader ended"
        with subprocess.Popen(["cat"], stdin=process.stdout, stdout=subprocess.DEVNULL):
            try:
                yield process
            finally:
                process.kill()
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def stopped(*pids: int) -> Iterator[None]:
    """Stop these processes until the end of the block."""
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)


def readers(count: int, seconds: float) -> dict[str, Any]:
    """Measure with a reader of DDS and one of rosbridge: disturbed means that both are stopped."""
    port = bus_at_work.free_port()
    fast_hz = bus_at_work.FAST_HZ
    settings = (*bus_at_work.ros2(fast_hz), "publish.w.kind=rosbridge", f"publish.w.port={port}",
                f"publish.w.rate_hz={6 * fast_hz}")  # fmt: skip
    dds = ("-m", PEER, str(bus_at_work.DOMAIN), "topic", "rt/odom", "Odometry")
    with bus_at_work.stage(*settings) as made:
        bus_at_work.bus_pid(made)
        with reader(*dds) as one, reader("-c", READER, str(port)) as other:
            time.sleep(bus_at_work.SETTLE_S)
            found = pairs(made, lambda: stopped(one.pid, other.pid), count, seconds)
        published = made.robot.status()["bus"]
        return found | {
            "restarts": published["restarts"],
            "dropped": sum(one["dropped"] for one in published["publishers"].values()),
        }


# ------------------------------------------------------------------------------- motord-bus itself
class Struck:
    """Disturbance that stops or breaks motord-bus at the beginning of a window."""

    def __init__(self, made: Any, planted: Planted, what: str) -> None:
        self._made, self._planted, self._what = made, planted, what

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        """Disturb a window; at its end wait until another motord-bus runs."""
        pid = bus_at_work.bus_pid(self._made)
        if self._what.startswith("SIG"):
            os.kill(pid, signal.Signals[self._what])
        else:
            self._planted.order(self._what)
        yield
        if self._what == "SIGSTOP":
            os.kill(pid, signal.SIGKILL)  # sooner than the daemon would
        wait_until(lambda: bus_at_work.bus_pid(self._made) != pid, "another process", BACK_WITHIN_S)
        time.sleep(bus_at_work.SETTLE_S)


def struck(what: str, count: int, seconds: float) -> dict[str, Any]:
    """Measure while motord-bus publishes and is killed, stopped, or leaks or fails by itself."""
    with tempfile.TemporaryDirectory() as folder:
        planted = Planted(Path(folder))
        settings = (*bus_at_work.ros2(bus_at_work.FAST_HZ), *planted.settings)
        with bus_at_work.stage(*settings, environ=planted.environ) as made:
            bus_at_work.bus_pid(made)
            time.sleep(bus_at_work.SETTLE_S)
            found = pairs(made, Struck(made, planted, what), count, seconds)
            return found | {"restarts": made.robot.status()["bus"]["restarts"]}


STRIKES = ("SIGKILL", "SIGSTOP", "segfault", "leak")


def measure(reader_pairs: int, strike_pairs: int, seconds: float) -> dict[str, Any]:
    """Return the figures of each disturbance."""
    found = {"readers stopped": readers(reader_pairs, seconds)}
    return found | {f"motord-bus: {what}": struck(what, strike_pairs, seconds) for what in STRIKES}


if __name__ == "__main__":
    print(json.dumps(measure(3, 1, 3.0), indent=1))
