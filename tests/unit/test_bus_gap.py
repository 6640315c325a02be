# SPDX-License-Identifier: Apache-2.0
"""A process that stood still: what comes right after that may be old."""

import asyncio
import contextlib
import time
from pathlib import Path

import pytest

from motord.bus.inputs import gap as gap_module
from motord.bus.inputs.desk import Desk, NotTaken
from motord.bus.inputs.gap import Gap
from motord.bus.station import Station
from motord.config import Ros2Input, load_robot

DEMO = Path(__file__).resolve().parents[2] / "config/robots/demo.toml"
LONGEST_S = 0.5
DEADLINE_S = 30.0
TWIST = {"linear": {"x": 0.2}, "angular": {"z": 0.0}}
WHEELS = {"name": ["left"], "velocity": [1.0]}


@contextlib.asynccontextmanager
async def watched(gap):
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(gap.watch())
        await asyncio.sleep(0)
        yield
        task.cancel()


def stand_still():
    time.sleep(1.5 * LONGEST_S)


async def over(gap):
    async with asyncio.timeout(DEADLINE_S):
        while gap.just_over():
            await asyncio.sleep(0.01)


async def test_whoever_asks_first_after_it_is_told():
    gap = Gap(LONGEST_S)
    async with watched(gap):
        assert not gap.just_over()
        stand_still()
        assert gap.just_over()


async def test_it_is_known_also_when_the_watch_looks_first(monkeypatch):
    gap = Gap(LONGEST_S)
    async with watched(gap):
        stand_still()
        await asyncio.sleep(0)
        assert gap.just_over()
        monkeypatch.setattr(gap_module, "DRAINED_AFTER_S", 0.0)
        await over(gap)
        assert not gap.just_over()


@pytest.mark.parametrize(("message", "method"), [(TWIST, "drive"), (WHEELS, "drive_joints")])
async def test_a_command_without_a_time_that_may_have_waited_is_refused(
    message, method, monkeypatch
):
    section = Ros2Input(kind="ros2", stamped=False, lease_s=LONGEST_S)
    station = Station(load_robot(DEMO), Path("no.sock"))
    desk = Desk("net", section, station)
    async with watched(desk._gap):
        with pytest.raises(NotTaken, match="there is no lease"):  # it would be passed on
            getattr(desk, method)(message)
        stand_still()
        with pytest.raises(NotTaken, match="stood still"):
            getattr(desk, method)(message)
        monkeypatch.setattr(gap_module, "DRAINED_AFTER_S", 0.0)
        await over(desk._gap)
        with pytest.raises(NotTaken, match="there is no lease"):
            getattr(desk, method)(message)


async def test_one_that_says_its_time_is_judged_by_that():
    section = Ros2Input(kind="ros2", lease_s=LONGEST_S)
    desk = Desk("net", section, Station(load_robot(DEMO), Path("no.sock")))
    async with watched(desk._gap):
        stand_still()
        sec, rest = divmod(time.time(), 1.0)
        stamp = {"sec": int(sec), "nanosec": int(rest * 1e9)}
        with pytest.raises(NotTaken, match="there is no lease"):
            desk.drive({"header": {"stamp": stamp}, "twist": TWIST})
