# SPDX-License-Identifier: Apache-2.0
"""Time from a cmd_vel on DDS to its first byte on the wire: a writer on the Cyclone DDS binding
(TwistStamped), motord-bus, the real daemon, its real-time line, and a slave that reports when the
bytes came; without and with busy Python threads in motord-bus or in the daemon. datagram.py
measures the part from the daemon on.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import signal
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.bench.command.datagram import PAUSE_S, _until, daemon, percentile
from tests.bench.fieldbus.wire import ROOT, SPEC_GAP_US, slave

from motord.bus.confine import REALTIME_PRIORITY_MAX
from motord.bus.ros2.dds.priority import set_policy
from motord_hal.modbus.codec import seal

DOMAIN = 91
INPUT = f"""
[input.ros2]
kind = "ros2"
domain_id = {DOMAIN}
priority = 200
lease_s = 2.0
"""
GOAL_P50_MS, GOAL_P99_MS, GOAL_RATIO = 0.25, 1.0, 2.0
HOGGED = ROOT / "tests/peers/ros2/hogged"
WHERE = {"idle": (0, 0), "busy motord-bus": (0, 4), "busy daemon": (4, 0)}
"""Numbers of busy Python threads in the daemon and in motord-bus."""
Found = dict[str, dict[str, float]]


@contextlib.contextmanager
def writer() -> Iterator[Any]:
    """Yield a function that writes one TwistStamped, stamped now. It encodes the message before it
    reads the clock of the measurement, so the time of a Python encoder is not measured."""
    from cyclonedds._clayer import ddspy_write
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from tests.peers.ros2.ros2_peer import LOCALHOST
    from tests.peers.ros2.ros2_peer_types import Header, Time, Twist, TwistStamped, Vector3

    domain = Domain(DOMAIN, LOCALHOST)
    participant = DomainParticipant(DOMAIN)
    reliable = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)))
    entity = DataWriter(participant, Topic(participant, "rt/cmd_vel", TwistStamped), qos=reliable)

    def write(linear_m_s: float) -> int:
        """Write a command; return the time of the write, or 0 if no client reads it."""
        sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
        twist = Twist(Vector3(linear_m_s, 0.0, 0.0), Vector3(0.0, 0.0, 0.0))
        raw = TwistStamped(Header(Time(sec, nanosec), ""), twist).serialize(use_version_2=False)
        given_ns = time.monotonic_ns() if entity.get_matched_subscriptions() else 0
        ddspy_write(entity._ref, raw)
        return given_ns

    try:
        yield write
    finally:
        del participant, domain


@contextlib.contextmanager
def _hogs_of_bus() -> Iterator[None]:
    """A motord-bus that starts in this block can start busy threads: HOGS of them, at SIGUSR1."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(HOGGED), *([before] if before else [])])
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def _pty_like_a_uart() -> None:
    """Give the kernel workers that pass on what is written to a pty priority over busy threads: a
    UART has no such worker. Only root can do it; otherwise their delay, up to 4 ms, is in the
    figures."""
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if (process / "comm").read_text(encoding="ascii").startswith("kworker/u"):
                os.sched_setscheduler(int(process.name), os.SCHED_FIFO, os.sched_param(1))


def delays_ms(hogs: int, bus_hogs: int, count: int, seed: int) -> tuple[list[float], int]:
    """Return the delay of each command, and the number of commands that the daemon did not accept.
    A fault ends the measurement. The daemon and its hogs have one CPU, motord-bus may use all."""
    chance, found = random.Random(seed), []
    with (
        tempfile.TemporaryDirectory() as made,
        slave(SPEC_GAP_US) as judge,
        _hogs_of_bus(),
        daemon(Path(made), judge.port, hogs or bus_hogs, INPUT, begin=False) as robot,
        writer() as write,
    ):
        pid = _until(lambda: robot.status()["bus"]["pid"], "motord-bus")
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.sched_setaffinity(int(thread), os.sched_getaffinity(0))
        _pty_like_a_uart()
        _until(
            lambda: robot.status()["bus"].get("inputs", {}).get("ros2", {}).get("lease"), "lease"
        )
        _until(lambda: write(0.0), "reader of cmd_vel")
        set_policy(os.SCHED_FIFO, REALTIME_PRIORITY_MAX, pid)  # as LimitRTPRIO of the unit does
        if hogs or bus_hogs:
            os.kill(robot.status()["pid"] if hogs else pid, signal.SIGUSR1)
        time.sleep(max(PAUSE_S))
        begun, written = robot.status()["commands"]["accepted"], 0
        while written < count:
            judge.ask("changed")
            given_ns = write(0.3 if written % 2 else 0.6)
            written += 1
            time.sleep(chance.uniform(*PAUSE_S))
            came_ns = judge.ask("changed")["changed_ns"]
            if robot.status()["state"] == "fault":
                break  # later bytes on the wire do not belong to a command
            found.append((given_ns, came_ns))
        lost = begun + written - robot.status()["commands"]["accepted"]
    return [(came - given) / 1e6 for given, came in found if came > given > 0], lost


def pty_delays_ms(count: int, seed: int) -> list[float]:
    """Return the delays from the write of a request that changes a register to its first byte at
    the slave: the part of each row that a UART does not have."""
    chance, found = random.Random(seed), []
    with slave(SPEC_GAP_US) as judge:
        _pty_like_a_uart()
        port = os.open(judge.port, os.O_RDWR | os.O_NOCTTY)
        try:
            tty.setraw(port)
            for value in range(1, count + 1):
                request = bytes((1, 6, 0, 0, value >> 8, value & 0xFF))
                judge.ask("changed")
                given_ns = time.monotonic_ns()
                os.write(port, seal(request))
                time.sleep(chance.uniform(*PAUSE_S))
                found.append(judge.ask("changed")["changed_ns"] - given_ns)
        finally:
            os.close(port)
    return [delay / 1e6 for delay in found]


def measure(count: int) -> Found:
    """Return a row for each of WHERE, and one of the pty alone."""
    alone = pty_delays_ms(count, seed=count)
    rows: Found = {"pty alone": _row(alone, 0)}
    for where, (hogs, bus_hogs) in WHERE.items():
        print(f"  {where}", file=sys.stderr, flush=True)
        rows[where] = _row(*delays_ms(hogs, bus_hogs, count, seed=count))
    return rows


def _row(delays: list[float], lost: int) -> dict[str, float]:
    found: dict[str, float] = {"lost": lost, "samples": len(delays)}
    if delays:
        found |= {"p50_ms": percentile(delays, 0.5), "p99_ms": percentile(delays, 0.99)}
    return found


def table(found: Found) -> str:
    rows = [
        f"{where:16} p50 {row.get('p50_ms', math.nan):6.2f}  p99 {row.get('p99_ms', math.nan):6.2f}"
        f" ms  {row['samples']:g} samples, lost {row['lost']:g}"
        for where, row in found.items()
    ]
    return "\n".join(["from a Twist on DDS to its first byte, four busy threads:", *rows])


def verdicts(found: Found) -> list[tuple[str, bool, bool]]:
    """Return the verdicts as `wire.verdicts` does."""
    made = []
    for where in WHERE:
        row, ratio = found[where], 1.0 if where == "idle" else GOAL_RATIO
        p50_ms, p99_ms = row.get("p50_ms", math.inf), row.get("p99_ms", math.inf)
        goals_ms = GOAL_P50_MS * ratio, GOAL_P99_MS * ratio
        text = (
            f"from Twist to byte, {where}: p50 {p50_ms:.2f} ms ({goals_ms[0]:g}), "
            f"p99 {p99_ms:.2f} ms ({goals_ms[1]:g})"
        )
        made.append((text, p50_ms <= goals_ms[0] and p99_ms <= goals_ms[1], False))
        made.append((f"and {row['lost']:g} commands lost (0)", row["lost"] == 0, True))
    return made
