# SPDX-License-Identifier: Apache-2.0
"""A gap, in which the process stood still: messages that arrive right after it may be old."""

import asyncio
import contextlib
import time
from pathlib import Path

import pytest

from motord.api.motion import Goal
from motord.bus.commands import gap as gap_module
from motord.bus.commands.gap import Gap
from motord.bus.commands.gate import ANY_TIME, METHODS, CommandGate, NotTaken
from motord.bus.commands.mover import Mover, NotNow
from motord.bus.parameters import Tunable
from motord.bus.runtime import Runtime
from motord.client import ClientError
from motord.config import Ros2Input, load_robot

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
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


async def test_the_first_request_after_a_gap_finds_it():
    gap = Gap(LONGEST_S)
    async with watched(gap):
        assert not gap.just_over()
        stand_still()
        assert gap.just_over()


async def test_a_gap_found_by_the_watch_lasts_until_queues_are_drained(monkeypatch):
    gap = Gap(LONGEST_S)
    async with watched(gap):
        stand_still()
        await asyncio.sleep(0)
        assert gap.just_over()
        monkeypatch.setattr(gap_module, "DRAINED_AFTER_S", 0.0)
        await over(gap)
        assert not gap.just_over()


@pytest.mark.parametrize(("message", "method"), [(TWIST, "drive"), (WHEELS, "drive_joints")])
async def test_a_command_without_a_stamp_that_may_have_waited_is_refused(
    message, method, monkeypatch
):
    section = Ros2Input(kind="ros2", stamped=False, lease_s=LONGEST_S)
    runtime = Runtime(load_robot(DEMO), Path("no.sock"))
    gate = CommandGate("net", section, runtime)
    async with watched(gate._gap):
        with pytest.raises(NotTaken, match="there is no lease"):  # no gap yet
            getattr(gate, method)(message)
        stand_still()
        with pytest.raises(NotTaken, match="stood still"):
            getattr(gate, method)(message)
        monkeypatch.setattr(gap_module, "DRAINED_AFTER_S", 0.0)
        await over(gate._gap)
        with pytest.raises(NotTaken, match="there is no lease"):
            getattr(gate, method)(message)


async def test_a_command_with_a_stamp_is_judged_by_its_stamp():
    section = Ros2Input(kind="ros2", lease_s=LONGEST_S)
    gate = CommandGate("net", section, Runtime(load_robot(DEMO), Path("no.sock")))
    async with watched(gate._gap):
        stand_still()
        sec, rest = divmod(time.time(), 1.0)
        stamp = {"sec": int(sec), "nanosec": int(rest * 1e9)}
        with pytest.raises(NotTaken, match="there is no lease"):
            gate.drive({"header": {"stamp": stamp}, "twist": TWIST})


@pytest.fixture
def gate():
    """A command gate whose commands must have a stamp; calls have no stamp."""
    runtime = Runtime(load_robot(DEMO), Path("no.sock"))
    return CommandGate("net", Ros2Input(kind="ros2", lease_s=0.1), runtime)


@pytest.mark.parametrize("method", sorted({*METHODS, *ANY_TIME}))
async def test_after_a_gap_only_calls_that_read_or_stop_are_passed_on(gate, method):
    obeyed = method in ("stop", "estop", "disarm", "status", "params.list")
    async with watched(gate.gap):
        stand_still()
        with pytest.raises((NotTaken, ClientError)) as sent:
            await gate.ask(method)
    assert ("no daemon has this socket" in str(sent.value)) == obeyed
    assert ("stood still" in str(sent.value)) != obeyed
    assert gate.source.refused == (not obeyed)


async def test_an_arm_is_passed_on_again_once_queues_are_drained(gate, monkeypatch):
    async with watched(gate.gap):
        stand_still()
        with pytest.raises(NotTaken, match="stood still"):
            await gate.act("arm")
        monkeypatch.setattr(gap_module, "DRAINED_AFTER_S", 0.0)
        await over(gate.gap)
        with pytest.raises(NotTaken, match="no daemon has this socket"):
            await gate.act("arm")


async def test_a_change_of_limits_that_may_have_waited_is_refused(gate):
    tunable = Tunable(load_robot(DEMO), gate.ask)
    async with watched(gate.gap):
        stand_still()
        with pytest.raises(NotTaken, match="stood still"):
            await tunable.change({"limits.linear_m_s": 1.0})


async def test_a_goal_that_may_have_waited_is_refused(gate):
    runtime = Runtime(load_robot(DEMO), Path("no.sock"))
    mover = Mover(runtime, gate.source, gate.gap, lease_s=0.1)
    async with watched(gate.gap):
        with pytest.raises(NotNow, match="no daemon has this socket"):  # no gap yet
            await mover.plan(Goal(axis="linear", distance_u=1.0))
        stand_still()
        with pytest.raises(NotNow, match="stood still"):
            await mover.plan(Goal(axis="linear", distance_u=1.0))
