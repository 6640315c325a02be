# SPDX-License-Identifier: Apache-2.0
"""Time from the start of `motord estop --force` and of `motord stop-all` to the first frame of the
stop on the wire, while the daemon hangs: python -m tests.bench.command.hung_daemon [RUNS]

Nothing else sends on that wire. The simulated drives count the requests that they receive."""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

from tests.sim.daemon_stage import DEADLINE_S, ROBOT, ROOT, running, set_off

WATCHDOG = "safety.drive_watchdog_s=10"
COMMANDS = ("estop --force", "stop-all")
HUNG_FOR_S = (0.0, 1.0)
GOAL_S = 1.5
SETTLED_S = 0.1


def seconds_to_stop(command: str, hung_for_s: float) -> tuple[float, float]:
    """Return the time from the command to the first frame, and to the end of the command."""
    with (
        tempfile.TemporaryDirectory() as at,
        mock.patch.dict(os.environ, {"XDG_RUNTIME_DIR": at}),
    ):
        folder, robot = Path(at) / "motord", Path(at) / "own.toml"
        folder.mkdir(mode=0o700)
        robot.write_text(ROBOT.read_text(encoding="utf-8"), encoding="utf-8")
        with running(folder, WATCHDOG, robot=robot) as stage:
            stage.wait_for("idle")
            set_off(stage, 0.5)
            stage.daemon.send_signal(signal.SIGSTOP)
            time.sleep(hung_for_s)
            words = {
                "estop --force": ["estop", "--force", "--socket", str(stage.socket)],
                "stop-all": ["stop-all", str(robot)],
            }[command]
            before = received_at_last(stage)
            begin_s = time.monotonic()
            with subprocess.Popen(
                [sys.executable, "-m", "motord", *words],
                cwd=ROOT,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            ) as process:
                while received(stage) == before:
                    if time.monotonic() - begin_s > DEADLINE_S:
                        raise TimeoutError("no frame of the stop")
                    time.sleep(0.002)
                first_s = time.monotonic() - begin_s
                assert process.wait(DEADLINE_S) == 0
            return first_s, time.monotonic() - begin_s


def received(stage) -> int:
    """Return how many requests the drives have received."""
    return sum(unit["requests"] for unit in stage.sim.stats()["lines"]["rs485"]["units"].values())


def received_at_last(stage) -> int:
    """Return the same, once the drives have received what was sent before the daemon stopped."""
    before, since_s = received(stage), time.monotonic()
    while time.monotonic() - since_s < SETTLED_S:
        if (now := received(stage)) != before:
            before, since_s = now, time.monotonic()
        time.sleep(0.01)
    return before


def measure(runs: int, hung_for_s: Sequence[float] = HUNG_FOR_S) -> dict[str, dict[str, Any]]:
    """Return for each command, and time since the daemon stopped: all times to the first frame, and
    the load of the machine meanwhile (the newest minute)."""
    found = {}
    for command in COMMANDS:
        for hung_s in hung_for_s:
            times_s = [seconds_to_stop(command, hung_s)[0] for _ in range(runs)]
            name = f"motord {command}, hung for {hung_s:g} s"
            found[name] = {"first_frame_s": times_s, "load": os.getloadavg()[0]}
    return found


def table(found: dict[str, dict[str, Any]]) -> str:
    return "\n".join(
        f"{name}: first frame of the stop after {statistics.median(one['first_frame_s']):.2f} s, "
        f"worst {max(one['first_frame_s']):.2f} s of {len(one['first_frame_s'])}, "
        f"load {one['load']:.1f}"
        for name, one in found.items()
    )


def verdicts(found: dict[str, dict[str, Any]]) -> list[tuple[str, bool, bool]]:
    """Return what was reached; a slow machine is nothing wrong."""
    return [
        (f"{name}: first frame within {GOAL_S:g} s", max(one["first_frame_s"]) <= GOAL_S, False)
        for name, one in found.items()
    ]


def main() -> None:
    found = measure(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
    print(table(found))


if __name__ == "__main__":
    main()
