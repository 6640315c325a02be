# SPDX-License-Identifier: Apache-2.0
"""motord-bus beside a daemon with simulated drives: memory of both, and CPU of each publisher.

python -m tests.bench.bus.bus_at_work memory|cpu
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.sim.daemon_stage import ROBOT, running, wait_until

DOMAIN = 90
SETTLE_S = 3.0
DEFAULT_HZ, FAST_HZ = 10, 50


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def memory_mb(pid: int) -> dict[str, float]:
    """Return the resident memory, and the same with shared pages divided among their users."""
    rows = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    found = {row.split()[0]: int(row.split()[1]) / 1024 for row in rows if row.endswith("kB")}
    return {"rss": found["Rss:"], "pss": found["Pss:"]}


def cpu_s(pid: int) -> float:
    """Return the CPU time of all threads by the scheduler's figures: clock ticks are too coarse."""
    rows = [
        task.read_text(encoding="ascii") for task in Path(f"/proc/{pid}/task").glob("*/schedstat")
    ]
    return sum(int(row.split()[0]) for row in rows) / 1e9


def children_s(pid: int) -> float:
    """Return the CPU time of children that have ended: proc(5), fields 16 and 17 of stat."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[13]) + int(fields[14])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def stage(*settings: str, **more: Any) -> Iterator[Any]:
    """Run a simulated robot until it is idle; yield its stage. `more`: arguments of `running`."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Path(folder), *settings, **more) as made,
    ):
        made.wait_for("idle")
        yield made


def bus_pid(made: Any) -> int:
    """Return the process number of motord-bus, once it has reported for the first time."""
    return int(wait_until(
        lambda: (found := made.robot.status()["bus"]) and "publishers" in found and found,
        "motord-bus",
    )["pid"])  # fmt: skip


def ros2(rate_hz: float) -> tuple[str, ...]:
    return ("publish.b.kind=ros2", f"publish.b.domain_id={DOMAIN}", f"publish.b.rate_hz={rate_hz}")


def memory() -> dict[str, dict[str, float]]:
    """Return the memory of the demonstration robot's daemon alone, and of both processes with ROS 2
    on DDS; also the CPU time of the daemon from its start to `idle`."""
    with stage() as made:
        start_s = cpu_s(made.daemon.pid) + children_s(made.daemon.pid)  # one reads the file
        time.sleep(SETTLE_S)
        found = {"daemon alone": memory_mb(made.daemon.pid) | {"cpu_to_idle_s": start_s}}
    with stage(*ros2(FAST_HZ)) as made:
        pid = bus_pid(made)
        time.sleep(SETTLE_S)
        found |= {"daemon": memory_mb(made.daemon.pid), "motord-bus": memory_mb(pid)}
    return found


# --------------------------------------------------------------------------------------------- CPU
def kinds(folder: Path, broker_port: int | None) -> dict[str, tuple[str, ...]]:
    """Return the settings of each kind of publisher that this machine has, one at a time."""
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
    """Run a broker and yield its port; yield None if mosquitto is not installed."""
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


def cpu(
    seconds: float, rates_hz: tuple[int, ...] = (DEFAULT_HZ, FAST_HZ)
) -> dict[str, dict[str, float]]:
    """Return the percentage of one CPU that motord-bus takes with one publisher and its topics, at
    its default rate and at 50 Hz. No client but the broker reads."""
    found: dict[str, dict[str, float]] = {}
    with (
        tempfile.TemporaryDirectory() as made_folder,
        mosquitto(Path(made_folder)) as broker_port,
        stage(options=("--no-bus",)) as made,
    ):
        name = made.robot.status()["robot"]
        for kind, settings in kinds(Path(made_folder), broker_port).items():
            found[kind] = {}
            for rate_hz in rates_hz:
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


if __name__ == "__main__":
    part = {"memory": memory, "cpu": lambda: cpu(5.0)}
    print(json.dumps(part[sys.argv[1]](), indent=1))
