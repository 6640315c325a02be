# SPDX-License-Identifier: Apache-2.0
"""Runs motord's real-time line against the bench's slave: prints "ready", then a line of JSON for
each line "stats" on stdin.

python client_motord.py PORT DRIVES GAP(spec|3.5char) FUNCTION(16|23) HOGS
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import resource
import sys
import threading
from pathlib import Path

from motord.config.drives.load import load_profile
from motord_hal.drives.profile import Gap
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, Echo, JointSpec, LineSpec
from motord_hal.realtime.exchange import Exchange

HERE = Path(__file__).parent


def spec_of(port: str, drives: int, gap: str, function: int) -> LineSpec:
    """Return the line: a single drive uses both its channels, several drives use one each."""
    profile = load_profile(HERE / "bench-drive.toml")
    if function == 23:
        profile = dataclasses.replace(profile, read_write_function=23)
    places = [(1, 1), (1, 2)] if drives == 1 else [(unit, 1) for unit in range(1, drives + 1)]
    joints = tuple(
        JointSpec(index=n, name=f"j{n}", profile=profile, unit=unit, channel=channel)
        for n, (unit, channel) in enumerate(places)
    )
    return LineSpec(
        index=0, name="bench", kind="modbus-rtu", port=port, baudrate=115200, parity="none",
        stop_bits=1, cycle_hz=1000.0, gap_s=None, gap=Gap(gap), engine="rt", joints=joints,
        watchdog_s=0.5, echo=Echo.NO,
    )  # fmt: skip


def hog() -> None:
    while True:
        sum(range(1000))


def process_cpu_ns() -> int:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return round((used.ru_utime + used.ru_stime) * 1e9)


def line_cpu_ns() -> int:
    """Return the CPU time of the line's thread: the first number of schedstat (proc(5))."""
    for task in Path("/proc/self/task").iterdir():
        if (task / "comm").read_text().startswith("motord-line"):
            return int((task / "schedstat").read_text().split()[0])
    raise RuntimeError("there is no thread of a line")


async def main(port: str, drives: int, gap: str, function: int, hogs: int) -> None:
    line = open_line(spec_of(port, drives, gap, function), Exchange.private(), lambda _: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        async with asyncio.timeout(20):
            while set(line.drive_states.values()) != {DriveState.READY}:
                await asyncio.sleep(0.05)
        for _ in range(hogs):
            threading.Thread(target=hog, daemon=True).start()
        print("ready", flush=True)
        loop = asyncio.get_running_loop()
        while (await loop.run_in_executor(None, sys.stdin.readline)).strip() == "stats":
            stats = line.stats()
            found = {
                "cpu_ns": line_cpu_ns() if hogs else process_cpu_ns(),
                "exchanges": stats.exchanges,
                "errors": stats.errors,
            }
            print(json.dumps(found), flush=True)
        running.cancel()


if __name__ == "__main__":
    asyncio.run(
        main(sys.argv[1], int(sys.argv[2]), sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
    )
