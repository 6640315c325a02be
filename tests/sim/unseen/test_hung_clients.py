# SPDX-License-Identifier: Apache-2.0
"""A daemon hangs as a whole: each program that requests a stop of it is informed by the state page,
with the process and what helps, and does not wait for an answer that will not come."""

import asyncio
import signal
import threading

import pytest
from tests.sim.daemon_stage import ROBOT, running, set_off, wait_until

from motord import aio
from motord.api.stop_request import DaemonHangs
from motord.bus.runtime import Runtime
from motord.client import Client, ClientError
from motord.config import load_robot

ENDLESS_S = 600.0
"""How long these programs would wait for an answer."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("hung"), "safety.drive_watchdog_s=10") as stage:
        stage.wait_for("idle")
        set_off(stage, 0.3)
        yield stage


@pytest.fixture
def hung(stage):
    stage.daemon.send_signal(signal.SIGSTOP)
    yield stage
    stage.daemon.send_signal(signal.SIGCONT)
    wait_until(lambda: stage.state() in ("estop", "armed", "idle", "moving", "fault"), "it goes on")


def by_client(stage, method):
    with Client(stage.socket, timeout_s=ENDLESS_S) as client:
        getattr(client, method)()


def by_aio(stage, method):
    async def request():
        async with aio.Client(stage.socket, timeout_s=ENDLESS_S) as client:
            await getattr(client, method)()

    asyncio.run(request())


def by_bus(stage, method):
    """Request it as each input of motord-bus does."""

    async def request():
        runtime = Runtime(load_robot(ROBOT), stage.socket)
        await runtime.call(method)

    asyncio.run(request())


@pytest.mark.parametrize("program", [by_client, by_aio, by_bus])
@pytest.mark.parametrize("method", ["estop", "stop", "disarm"])
def test_a_program_is_informed_of_a_daemon_that_hangs(hung, program, method):
    found = []

    def request():
        try:
            program(hung, method)
        except ClientError as error:
            found.append(error)

    waiting = threading.Thread(target=request, daemon=True)
    waiting.start()
    wait_until(lambda: found, "an error")
    (error,) = found
    assert isinstance(error, DaemonHangs)
    assert f"process {hung.daemon.pid}, stopped by a signal" in str(error)
    assert "motord estop --force" in str(error)


@pytest.mark.parametrize("program", [by_client, by_aio, by_bus])
def test_a_daemon_that_goes_on_in_time_answers(stage, program):
    stage.daemon.send_signal(signal.SIGSTOP)
    going_on = threading.Timer(0.3, stage.daemon.send_signal, (signal.SIGCONT,))
    going_on.start()
    program(stage, "estop")
    going_on.join()
    assert stage.state() == "estop"
