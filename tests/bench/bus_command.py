# SPDX-License-Identifier: Apache-2.0
"""From a cmd_vel on DDS to its first byte on the wire: a writer of another make (the Cyclone DDS
binding, TwistStamped), motord-bus, the real daemon, its real-time line, and a slave that says when
the bytes came. Idle, and with busy Python threads in the daemon; datagram.py measures the part of
it that begins at the daemon.
"""

from __future__ import annotations

import contextlib
import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from datagram import PAUSE_S, _until, daemon, percentile
from wire import ROOT, SPEC_GAP_US, slave

sys.path.insert(0, str(ROOT / "tests/peers"))
DOMAIN = 91
INPUT = f"""
[input.ros2]
kind = "ros2"
domain_id = {DOMAIN}
priority = 200
lease_s = 2.0
"""
GOAL_P50_US, GOAL_P99_US, GOAL_RATIO = 500.0, 1500.0, 1.5


@contextlib.contextmanager
def writer() -> Iterator[Any]:
    """Writes one TwistStamped, stamped now, each time it is called; it has been encoded when the
    clock is read: what a writer in Python takes for that is not measured."""
    from cyclonedds._clayer import ddspy_write
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from ros2_peer import LOCALHOST
    from ros2_peer_types import Header, Time, Twist, TwistStamped, Vector3

    domain = Domain(DOMAIN, LOCALHOST)
    participant = DomainParticipant(DOMAIN)
    reliable = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)))
    entity = DataWriter(participant, Topic(participant, "rt/cmd_vel", TwistStamped), qos=reliable)

    def write(linear_m_s: float) -> int:
        """When it was written; 0: nobody reads it."""
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


def delays_us(hogs: int, count: int, seed: int) -> list[float]:
    """As datagram.delays_us. The hogs have the daemon's CPU; motord-bus keeps the others."""
    chance, found = random.Random(seed), []
    with (
        tempfile.TemporaryDirectory() as made,
        slave(SPEC_GAP_US) as judge,
        daemon(Path(made), judge.port, hogs, INPUT) as robot,
        writer() as write,
    ):
        pid = _until(lambda: robot.status()["bus"]["pid"], "motord-bus")
        os.sched_setaffinity(pid, os.sched_getaffinity(0))
        _until(
            lambda: robot.status()["bus"].get("inputs", {}).get("ros2", {}).get("lease"), "lease"
        )
        _until(lambda: write(0.0), "reader of cmd_vel")
        for number in range(count):
            judge.ask("changed")
            given_ns = write(0.3 if number % 2 else 0.6)
            time.sleep(chance.uniform(*PAUSE_S))
            found.append((given_ns, judge.ask("changed")["changed_ns"]))
    return [(came_ns - given_ns) / 1e3 for given_ns, came_ns in found if came_ns > given_ns]


def measure(count: int, hogs: int = 4) -> dict[str, dict[str, float]]:
    """Idle and hogged, in turns."""
    pools: dict[int, list[float]] = {0: [], hogs: []}
    for part, number in enumerate((0, hogs, hogs, 0)):
        pools[number] += delays_us(number, count // 2, seed=part)
    return {
        name: {"p50_us": percentile(pool, 0.5), "p90_us": percentile(pool, 0.9),
               "p99_us": percentile(pool, 0.99), "samples": len(pool)}
        for name, pool in (("idle", pools[0]), ("hogged", pools[hogs]))
    }  # fmt: skip
