# SPDX-License-Identifier: Apache-2.0
"""motord-bus beside a daemon with simulated drives: memory of both, CPU of each publisher, and what
a reader that stops reading costs the loop.

python bus_at_work.py memory|cpu|stalled
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.sim.daemon_stage import ROBOT, running, wait_until  # noqa: E402  the path is made above

DOMAIN = 90
PEER = ROOT / "tests/peers/ros2_peer.py"
SETTLE_S = 3.0
DEFAULT_HZ, FAST_HZ = 10, 50
READER = """
import json, socket, sys
from websockets.sync.client import connect
wire = socket.socket()
wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)  # it is full soon
wire.connect(("127.0.0.1", int(sys.argv[1])))
with connect("ws://localhost/", sock=wire, max_size=None, ping_interval=None) as bus:
    for topic in ("odom", "tf", "joint_states", "motor_status"):
        bus.send(json.dumps({"op": "subscribe", "topic": f"/{topic}"}))
    print("ready", flush=True)
    for _ in bus:
        pass
"""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def memory_mb(pid: int) -> dict[str, float]:
    """Resident, and with shared pages counted once for all who share them."""
    rows = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    found = {row.split()[0]: int(row.split()[1]) / 1024 for row in rows if row.endswith("kB")}
    return {"rss": found["Rss:"], "pss": found["Pss:"]}


def cpu_s(pid: int) -> float:
    """Of all its threads, by the scheduler's own account: clock ticks are too coarse."""
    rows = [
        task.read_text(encoding="ascii") for task in Path(f"/proc/{pid}/task").glob("*/schedstat")
    ]
    return sum(int(row.split()[0]) for row in rows) / 1e9


@contextlib.contextmanager
def stage(*settings: str, options: tuple[str, ...] = ()) -> Iterator[Any]:
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Path(folder), *settings, options=options) as made,
    ):
        made.wait_for("idle")
        yield made


def bus_pid(made: Any) -> int:
    """Of the second process, once it has said its first word."""
    return int(wait_until(
        lambda: (found := made.robot.status()["bus"]) and "publishers" in found and found,
        "motord-bus",
    )["pid"])  # fmt: skip


def ros2(rate_hz: float) -> tuple[str, ...]:
    return ("publish.b.kind=ros2", f"publish.b.domain_id={DOMAIN}", f"publish.b.rate_hz={rate_hz}")


def memory() -> dict[str, dict[str, float]]:
    """Of the daemon of the demonstration robot, alone, and of both processes with ROS 2 on DDS."""
    with stage() as made:
        time.sleep(SETTLE_S)
        found = {"daemon alone": memory_mb(made.daemon.pid)}
    with stage(*ros2(FAST_HZ)) as made:
        pid = bus_pid(made)
        time.sleep(SETTLE_S)
        found |= {"daemon": memory_mb(made.daemon.pid), "motord-bus": memory_mb(pid)}
    return found


# --------------------------------------------------------------------------------------------- CPU
def kinds(folder: Path, broker_port: int | None) -> dict[str, tuple[str, ...]]:
    """Each publisher that can be had here, alone."""
    found = {
        "prometheus, never asked": ("publish.b.kind=prometheus", f"publish.b.port={free_port()}"),
        "ros2": ("publish.b.kind=ros2", f"publish.b.domain_id={DOMAIN}"),
        "foxglove": ("publish.b.kind=foxglove", f"publish.b.port={free_port()}"),
        "rosbridge": ("publish.b.kind=rosbridge", f"publish.b.port={free_port()}"),
        "mcap": ("publish.b.kind=mcap", f"publish.b.folder={folder / 'mcap'}"),
    }
    if broker_port is not None:
        found["mqtt"] = ("publish.b.kind=mqtt", f"publish.b.port={broker_port}")
    return found


@contextlib.contextmanager
def mosquitto(folder: Path) -> Iterator[int | None]:
    """Its port; None where it is not installed."""
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        yield None
        return
    port, config = free_port(), folder / "mosquitto.conf"
    config.write_text(
        f"listener {port} 127.0.0.1\nuser root\nallow_anonymous true\n", encoding="ascii"
    )
    with subprocess.Popen([program, "-c", str(config)], stderr=subprocess.DEVNULL) as process:
        try:
            yield port
        finally:
            process.kill()


def cpu(seconds: float) -> dict[str, dict[str, float]]:
    """Percent of one CPU that motord-bus takes with one publisher and its topics, at the rate that
    it has by default and at 50 Hz. Nobody reads, but for the broker."""
    found: dict[str, dict[str, float]] = {}
    with (
        tempfile.TemporaryDirectory() as made_folder,
        mosquitto(Path(made_folder)) as broker_port,
        stage(options=("--no-bus",)) as made,
    ):
        name = made.robot.status()["robot"]
        for kind, settings in kinds(Path(made_folder), broker_port).items():
            found[kind] = {}
            for rate_hz in (DEFAULT_HZ, FAST_HZ):
                words = [f"robot.name={name}", *settings, f"publish.b.rate_hz={rate_hz}"]
                command = [sys.executable, "-m", "motord.bus", str(ROBOT), "--socket"]
                command += [str(made.socket), *(part for word in words for part in ("--set", word))]
                with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
                    try:
                        time.sleep(SETTLE_S)
                        before_s = cpu_s(process.pid)
                        time.sleep(seconds)
                        used_s = cpu_s(process.pid) - before_s
                        found[kind][f"{rate_hz} Hz"] = 100.0 * used_s / seconds
                    finally:
                        process.terminate()
    return found


# ---------------------------------------------------------------------------------- a stuck reader
@contextlib.contextmanager
def reader(*command: str) -> Iterator[subprocess.Popen[str]]:
    """Once it reads."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline(), "the reader ended"
        yield process
    finally:
        process.kill()
        process.wait()


def one_run(stopped: bool, seconds: float) -> dict[str, float]:
    """A daemon's life with a reader of DDS and one of rosbridge, which read or are stopped."""
    port = free_port()
    settings = (*ros2(FAST_HZ), "publish.w.kind=rosbridge", f"publish.w.port={port}",
                f"publish.w.rate_hz={6 * FAST_HZ}")  # fmt: skip
    with stage(*settings) as made, contextlib.ExitStack() as readers:
        bus_pid(made)
        processes = [
            readers.enter_context(reader(str(PEER), str(DOMAIN), "topic", "rt/odom", "Odometry")),
            readers.enter_context(reader("-c", READER, str(port))),
        ]
        if stopped:
            for process in processes:
                process.send_signal(signal.SIGSTOP)
        else:  # whoever prints is read
            readers.callback(_drain(processes[0]))
        before = made.robot.status()
        time.sleep(seconds)
        after = made.robot.status()
        counts = [sum(p[key] for p in after["bus"]["publishers"].values()) for key in COUNTED]
        return {
            "p50_us": after["loop"]["lateness_us"]["p50"],
            "p99_us": after["loop"]["lateness_us"]["p99"],
            "overruns": after["loop"]["overruns"] - before["loop"]["overruns"],
            "restarts": after["bus"]["restarts"],
            **dict(zip(COUNTED, counts, strict=True)),
        }


COUNTED = ("taken", "dropped")


def _drain(process: subprocess.Popen[str]) -> Any:
    assert process.stdout is not None
    sink = subprocess.Popen(["cat"], stdin=process.stdout, stdout=subprocess.DEVNULL)
    return sink.kill


def stalled(rounds: int, seconds: float) -> dict[str, dict[str, float]]:
    """Medians of the rounds, reading and stopped in turns."""
    rows: dict[bool, list[dict[str, float]]] = {False: [], True: []}
    for _ in range(rounds):
        for stopped, found in rows.items():
            found.append(one_run(stopped, seconds))
    return {
        name: {
            key: statistics.median(row[key] for row in rows[stopped]) for key in rows[stopped][0]
        }
        for name, stopped in (("reading", False), ("stopped", True))
    }


if __name__ == "__main__":
    part = {"memory": memory, "cpu": lambda: cpu(5.0), "stalled": lambda: stalled(3, 6.0)}
    print(json.dumps(part[sys.argv[1]](), indent=1))
