# SPDX-License-Identifier: Apache-2.0
"""A source that sends as many commands as it can, and a source of higher priority beside it."""

import asyncio
import contextlib
import subprocess
import sys
from pathlib import Path

from tests.sim.daemon_stage import running, wait_until

from motord.bus.commands.link import Source

COMMANDS = 30
EVERY_S = 0.02
SETTINGS = (
    "input.flood.kind=rt",
    "input.flood.priority=10",
    "input.pad.kind=ros2-rclpy",
    "input.pad.trust_network=true",
    "input.pad.priority=500",
    "input.pad.lease_s=5.0",
)


@contextlib.contextmanager
def flood(stage):
    program = [sys.executable, str(Path(__file__).with_name("flooder.py")), str(stage.socket)]
    with subprocess.Popen(program, stdout=subprocess.PIPE) as flooder:
        assert flooder.stdout.readline().strip() == b"flooding"
        try:
            yield
        finally:
            flooder.kill()


async def rest(stage):
    """Command rest as the pad, then release its lease; return the owners in command meanwhile."""
    source, seen = Source(stage.socket, "pad"), []
    async with asyncio.TaskGroup() as tasks:
        holding = tasks.create_task(source.run())
        async with asyncio.timeout(30):
            while not source.ready:
                await asyncio.sleep(0.01)
            for _ in range(COMMANDS):
                assert source.drive(0.0, 0.0)
                await asyncio.sleep(EVERY_S)
                seen.append(await asyncio.to_thread(leases, stage))
            assert source.release()
            while (await asyncio.to_thread(leases, stage))[:1] != ["flood"]:
                await asyncio.sleep(0.01)
        holding.cancel()
    assert (source.sent, source.lost) == (COMMANDS + 1, 0)
    return {owners[0] for owners in seen}


def leases(stage):
    """Return the owners of the leases, the one in command first."""
    found = stage.robot.status()["leases"]
    for lease in found[1:]:
        assert lease["why"] == f"waits: {found[0]['owner']} has a higher priority"
    return [lease["owner"] for lease in found]


def commander(stage):
    return next(iter(leases(stage)), None)


def test_a_flood_does_not_hold_up_a_command_of_higher_priority(tmp_path):
    with running(tmp_path, *SETTINGS) as stage:
        stage.wait_for("idle")
        stage.robot.arm()
        with flood(stage):
            wait_until(lambda: commander(stage) == "flood", "the flood commands")
            assert asyncio.run(rest(stage)) == {"pad"}
            first = stage.robot.status()["leases"][0]
            assert first["why"].startswith("in command")
            assert first["rate_hz"] > 100.0


def refused(stage):
    return stage.robot.status()["commands"]["refused"]["rate"]


def test_a_source_is_limited_to_the_rate_in_the_robot_file(tmp_path):
    with running(tmp_path, *SETTINGS, "input.flood.rate_max_hz=50") as stage:
        stage.wait_for("idle")
        with flood(stage):
            wait_until(lambda: commander(stage) == "flood", "the flood commands")
            wait_until(lambda: refused(stage) > 1000, "commands above the rate are refused")
            # at first some commands may exceed the rate
            wait_until(
                lambda: 0.0 < stage.robot.status()["leases"][0]["rate_hz"] < 60.0, "its rate"
            )
