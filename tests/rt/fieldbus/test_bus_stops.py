# SPDX-License-Identifier: Apache-2.0
"""The second process stops the robot through the real loop when it cannot reach the daemon."""

import asyncio
import contextlib
import dataclasses
import uuid
from pathlib import Path

import pytest
from tests.rt.small_base import core_config, settings, until

from motord.bus.runtime import Runtime
from motord.client import ClientError
from motord.config import load_robot
from motord.local_socket.command_sockets import open_stop_socket
from motord.realtime import loop as rt

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
DEADLINE_S = 30.0


@contextlib.asynccontextmanager
async def running(runtime):
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        task = tasks.create_task(runtime.run())
        while runtime.view is None:
            await asyncio.sleep(0.01)
        yield
        task.cancel()


@pytest.fixture
def robot():
    return load_robot(DEMO, [f"robot.name=t{uuid.uuid4().hex[:12]}"])


@contextlib.contextmanager
def looped(robot, path):
    with (
        open_stop_socket(robot, path) as stop_fd,
        rt.Loop(
            core_config(), dataclasses.replace(settings(), stop_fd=stop_fd), robot.robot.name
        ) as loop,
    ):
        yield loop


@pytest.mark.parametrize("method", ["stop", "estop", "disarm"])
async def test_the_robot_is_stopped_even_without_a_free_descriptor(
    robot, tmp_path, method, no_descriptor_left
):
    path = tmp_path / "robot.sock"
    runtime = Runtime(robot, path)
    with looped(robot, path) as loop:
        async with running(runtime):
            with no_descriptor_left():
                state = (await runtime.call(method))["state"]
                with pytest.raises(ClientError, match="Too many open files"):
                    await runtime.call("arm")
            assert getattr(loop.stop_requests(), method) == 1
            assert state == ("estop" if method == "estop" else "off")


async def test_a_daemon_that_was_started_again_is_stopped_by_the_same_socket(robot, tmp_path):
    path = tmp_path / "robot.sock"
    runtime = Runtime(robot, path)
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        task = tasks.create_task(runtime.run())
        for _ in range(2):
            with looped(robot, path) as loop:
                while not await runtime._stops.send("estop"):
                    await asyncio.sleep(0.01)
                until(lambda loop=loop: loop.stop_requests().estop)
        task.cancel()


async def test_a_missing_daemon_is_reported_as_for_every_call(robot, tmp_path):
    runtime = Runtime(robot, tmp_path / "none.sock")
    with pytest.raises(ClientError, match="no daemon has this socket"):
        await runtime.call("estop")
