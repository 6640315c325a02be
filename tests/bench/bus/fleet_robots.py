# SPDX-License-Identifier: Apache-2.0
"""Many robots' motord-bus in one process: each has its own robot file, runtime and adapters. Only
the snapshots are made here, instead of being read from a daemon's page.

python -m tests.bench.bus.fleet_robots FIRST COUNT SETTING...
In a setting, {n} is the robot's number.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import signal
import sys
import time
from pathlib import Path

from tests.bench.bus.bus_encode import moving

from motord.bus.runtime import Runtime
from motord.config import load_robot

ROBOT = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
LOOK_EVERY_S = 0.05


def runtime(number: int, settings: list[str]) -> Runtime:
    words = [f"robot.name=r{number}", *(one.format(n=number) for one in settings)]
    return Runtime(load_robot(ROBOT, tuple(words)), Path("/nonexistent"))


async def drive(stations: list[Runtime]) -> None:
    """Give each robot's runtime a current snapshot periodically, until cancelled."""
    snapshot = moving().snapshot
    while True:
        now_ns = time.monotonic_ns()
        for one in stations:
            one._feed(dataclasses.replace(snapshot, stamp_ns=now_ns, odometry_stamp_ns=now_ns))
        await asyncio.sleep(LOOK_EVERY_S)


async def main(first: int, count: int, settings: list[str]) -> None:
    stations = [runtime(first + number, settings) for number in range(count)]
    end = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, end.set)
    async with asyncio.TaskGroup() as tasks:
        work = [tasks.create_task(drive(stations))]
        for one in stations:
            work += [tasks.create_task(adapter.run()) for adapter in one._adapters().values()]
        print("ready", flush=True)
        await end.wait()
        for task in work:
            task.cancel()


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
