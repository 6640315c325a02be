# SPDX-License-Identifier: Apache-2.0
"""CPU that a board on a serial stream costs, and the time from set-points to feedback, with and
without a thread that always competes for the GIL. The board is the reference board as a program.

    python tests/bench/fieldbus/board_stream.py PORT SECONDS idle|hog   (what `measure` starts)
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "contract/boards"))

from mcu_peer import McuPeer, compiled

RATE_HZ = 200.0
WARM_UP_S = 0.5
Found = dict[str, dict[str, float]]


def hog() -> None:
    while True:
        sum(range(1000))


async def drive(port: str, seconds: float) -> dict[str, float]:
    from motord.config.drives.load import find_profile
    from motord_hal.fieldbus.open_line import open_line
    from motord_hal.fieldbus.ports import DriveState, JointSpec, LineSpec
    from motord_hal.realtime.exchange import Exchange

    profile = find_profile("mcu-velocity")
    joints = tuple(
        JointSpec(index=n, name=f"j{n}", profile=profile, unit=1, channel=n + 1) for n in range(2)
    )
    spec = LineSpec(
        index=0, name="bench", kind="mcu", port=port, baudrate=921600, parity="none", stop_bits=1,
        cycle_hz=RATE_HZ, gap_s=None, engine="auto", joints=joints, watchdog_s=1.0,
    )  # fmt: skip
    line = open_line(spec, Exchange.private(), lambda _: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        async with asyncio.timeout(20):
            while set(line.drive_states.values()) != {DriveState.READY}:
                await asyncio.sleep(0.05)
        await asyncio.sleep(WARM_UP_S)
        before = time.process_time_ns(), line.stats().exchanges
        await asyncio.sleep(seconds)
        spent_ns, stats = time.process_time_ns() - before[0], line.stats()
        running.cancel()
    received = stats.exchanges - before[1]
    return {
        "cpu_us": spent_ns * 1e-3 / max(received, 1),
        "p50_us": stats.round_trip.p50_us,
        "p99_us": stats.round_trip.p99_us,
    }


def measure(seconds: float) -> Found:
    """Return the figures without and with a hog. CPU is that of the whole process, so with a hog it
    means nothing."""
    found: Found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = compiled(folder)
        for company in ("idle", "hog"):
            peer = McuPeer(program, folder / "board")
            command = [sys.executable, __file__, str(peer.link), str(seconds), company]
            run = subprocess.run(command, capture_output=True, text=True, timeout=90)
            peer.pull()
            run.check_returncode()
            found[company] = json.loads(run.stdout)
    return found


def table(found: Found) -> str:
    """Return the figures as text."""
    rows = [
        f"{name:14} CPU a feedback {row['cpu_us']:7.1f} µs   set-points to feedback "
        f"p50 {row['p50_us']:7.0f}  p99 {row['p99_us']:7.0f} µs"
        for name, row in found.items()
    ]
    return "\n".join([f"a board at {RATE_HZ:g} Hz:", *rows])


def verdicts(found: Found) -> list[tuple[str, bool, bool]]:
    """Return the verdicts as `wire.verdicts` does."""
    wait = found["hog"]["p99_us"] / found["idle"]["p99_us"]
    text = f"a board waits {wait:.2f} of its idle p99 beside a GIL hog"
    return [(text, wait < 2.0, False)]


if __name__ == "__main__":
    if sys.argv[3] == "hog":
        threading.Thread(target=hog, daemon=True).start()
    print(json.dumps(asyncio.run(drive(sys.argv[1], float(sys.argv[2])))))
