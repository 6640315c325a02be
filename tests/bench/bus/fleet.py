# SPDX-License-Identifier: Apache-2.0
"""The cost of a fleet for one of its robots. One robot is complete: a daemon, and motord-bus in a
network namespace. The others' publishers are in four processes in another namespace, with the
router or broker; a cable between the two namespaces is the robot's network. Needs root.

python -m tests.bench.bus.fleet [OTHERS [KIND...]]
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.bench.bus.bus_at_work import ROBOT, cpu_s, memory_mb, stage
from tests.peers.mqtt.mosquitto import BROKER
from tests.peers.namespaces import THERE, Cable, cable, inside, why_not

PROCESSES = 4
JOIN_S, MEASURE_S = 12.0, 10.0
DOMAIN = 92
ROUTER = '''
import signal, sys, zenoh
settings = """{mode: "router", listen: {endpoints: ["tcp/%s:7447"]},
          scouting: {multicast: {enabled: false}}}"""
with zenoh.open(zenoh.Config.from_json5(settings % sys.argv[1])):
    print("ready", flush=True)
    signal.pause()
'''


def settings(kind: str) -> list[str]:
    """Return settings for a robot: {n} stands for its number; topics and rates are the defaults."""
    if kind == "mqtt":
        return [
            "publish.b.kind=mqtt",
            f"publish.b.host={THERE}",
            "publish.b.topic_prefix=fleet/r{n}",
        ]
    found = [f"publish.b.kind={kind}", f"publish.b.domain_id={DOMAIN}", "publish.b.namespace=/r{n}"]
    if kind == "ros2":
        return [*found, "publish.b.discovery=subnet", "publish.b.interface=cable"]
    return [*found, f"publish.b.router=tcp/{THERE}:7447"]


@contextlib.contextmanager
def started(*command: str, ready: bool = True) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        if ready:
            assert process.stdout is not None
            assert process.stdout.readline(), command
        yield process
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextlib.contextmanager
def middle(kind: str, wire: Cable, folder: Path) -> Iterator[int | None]:
    """Run the broker or router if this kind needs one; yield its process number, else None."""
    there = inside(wire.there)
    if kind == "mqtt":
        config = folder / "mosquitto.conf"
        config.write_text(f"listener 1883 {THERE}\nuser root\nallow_anonymous true\n", "ascii")
        assert BROKER is not None, "apt install mosquitto"
        with started(*there, BROKER, "-c", str(config), ready=False) as process:
            yield process.pid
    elif kind == "ros2-zenoh":
        with started(*there, sys.executable, "-c", ROUTER, THERE) as process:
            yield process.pid
    else:
        yield None


def bytes_on(wire: Cable) -> tuple[int, int]:
    """Return the bytes that the complete robot has received and sent."""
    run = subprocess.run(
        ["ip", "-n", wire.here, "-j", "-s", "link", "show", "cable"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    counts = json.loads(run.stdout)[0]["stats64"]
    return counts["rx"]["bytes"], counts["tx"]["bytes"]


def one(kind: str, others: int) -> dict[str, float]:
    """Return the figures of the complete robot among so many others."""
    with (
        tempfile.TemporaryDirectory() as made_folder,
        cable() as wire,
        middle(kind, wire, Path(made_folder)) as middle_pid,
        stage(options=("--no-bus",)) as made,
        contextlib.ExitStack() as fleet,
    ):
        rows = [f"robot.name={made.robot.status()['robot']}",
                *(row.format(n=0) for row in settings(kind))]  # fmt: skip
        bus = fleet.enter_context(started(
            *inside(wire.here), sys.executable, "-m", "motord.bus", str(ROBOT), "--socket",
            str(made.socket), *(word for row in rows for word in ("--set", row)), ready=False,
        ))  # fmt: skip
        time.sleep(JOIN_S / 3)
        joining = bytes_on(wire)
        began_s, cpu_began_s = time.monotonic(), cpu_s(bus.pid)
        each, rest = divmod(others, PROCESSES)
        first = 1
        for number in range(PROCESSES):
            count = each + (number < rest)
            if count:
                fleet.enter_context(started(
                    *inside(wire.there), sys.executable, "-m", "tests.bench.bus.fleet_robots",
                    str(first), str(count), *settings(kind),
                ))  # fmt: skip
            first += count
        time.sleep(JOIN_S)
        joined_s, joined = time.monotonic() - began_s, bytes_on(wire)
        cpu_joined_s = cpu_s(bus.pid)
        middle_before_s = cpu_s(middle_pid) if middle_pid else 0.0
        time.sleep(MEASURE_S)
        now, used_s = bytes_on(wire), cpu_s(bus.pid) - cpu_joined_s
        middle_s = (cpu_s(middle_pid) if middle_pid else 0.0) - middle_before_s
        return {
            "others": others,
            "rss_mb": memory_mb(bus.pid)["rss"],
            "cpu_percent": 100 * used_s / MEASURE_S,
            "received_kb_s": (now[0] - joined[0]) / 1e3 / MEASURE_S,
            "sent_kb_s": (now[1] - joined[1]) / 1e3 / MEASURE_S,
            "join_kb": (joined[0] + joined[1] - sum(joining)) / 1e3,
            "join_s": joined_s,
            "join_cpu_s": cpu_joined_s - cpu_began_s,
            "middle_cpu_percent": 100 * middle_s / MEASURE_S,
            "middle_rss_mb": memory_mb(middle_pid)["rss"] if middle_pid else 0.0,
        }


def measure(others: int, kinds: tuple[str, ...]) -> dict[str, list[dict[str, float]]]:
    """Return the complete robot's figures by kind, alone and among the others."""
    return {kind: [one(kind, number) for number in (0, others)] for kind in kinds}


def table(found: dict[str, Any]) -> str:
    rows = ["one robot of a fleet, all topics at their default rates:"]
    for kind, pair in found.items():
        for row in pair:
            words = (f"{key} {value:.1f}" for key, value in row.items() if key != "others")
            rows.append(f"  {kind:11} {row['others']:3.0f} others  " + "  ".join(words))
    return "\n".join(rows)


if __name__ == "__main__":
    if why := why_not():
        sys.exit(why)
    number = int(sys.argv[1]) if len(sys.argv) > 1 else 99
    print(table(measure(number, tuple(sys.argv[2:]) or ("ros2", "ros2-zenoh", "mqtt"))))
