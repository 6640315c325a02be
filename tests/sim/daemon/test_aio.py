# SPDX-License-Identifier: Apache-2.0
"""motord.aio with a whole daemon: it does what motord.client does, and blocks no event loop."""

import asyncio
import contextlib
import inspect
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, SURE, TRIES, running, wait_until, was_held_up

from motord import client
from motord.aio import Client, ClientError, MoveFailed, Refused


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("aio"), *SURE) as stage:
        stage.wait_for("idle")
        yield stage


def connected(stage):
    return Client(stage.socket, timeout_s=DEADLINE_S)


async def turning(stage):
    while await asyncio.to_thread(lambda: stage.sim.truth().at_rest):
        await asyncio.sleep(0.01)


def test_it_has_every_method_of_the_blocking_client_with_the_same_parameters():
    public = {
        name: method
        for name, method in inspect.getmembers(client.Client, inspect.isfunction)
        if not name.startswith("_")
    }
    for name, method in public.items():
        twin = getattr(Client, name)
        assert inspect.iscoroutinefunction(twin), name
        assert inspect.signature(twin).parameters == inspect.signature(method).parameters, name


async def test_the_end_of_a_daemon_is_noticed(tmp_path):
    served = asyncio.Event()

    async def attend(_reader, writer):
        served.set()
        writer.close()

    server = await asyncio.start_unix_server(attend, str(tmp_path / "sock"))
    async with server, asyncio.timeout(DEADLINE_S), Client(tmp_path / "sock") as robot:
        await robot.ended()
        assert served.is_set()
    with pytest.raises(ClientError, match="is closed"):
        await robot.ended()


def test_it_imports_only_the_standard_library():
    code = (
        "import sys; before = set(sys.modules); import motord.aio\n"  # a distribution imports, too
        "names = {name.partition('.')[0] for name in sys.modules.keys() - before}\n"
        "ours = names - set(sys.stdlib_module_names)\n"
        "print(sorted(name for name in ours if not name.startswith('_')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "['motord', 'motord_hal']\n"


async def in_time(move):
    """Return the result of `move`; repeat it where it was held up, up to TRIES times."""
    for _ in range(TRIES - 1):
        try:
            return await move()
        except MoveFailed as error:
            if not was_held_up(error):
                raise
    return await move()


async def test_it_arms_moves_turns_and_disarms(stage, armed):
    async with connected(stage) as robot:
        await robot.reset_odometry()
        moved = await in_time(lambda: robot.move(0.3))
        assert moved.distance_m == pytest.approx(0.3, abs=0.011)
        turned = await in_time(lambda: robot.turn(0.4))
        assert turned.angle_rad == pytest.approx(0.4, abs=0.021)
        status = await robot.status()
        assert (status.state, status.leases) == ("armed", ())
        assert await robot.disarm() == "idle"
        with pytest.raises(Refused, match="motord arm"):
            await robot.drive(0.1, 0.0)


async def test_a_stop_by_another_task_ends_a_move(stage, armed):
    async with connected(stage) as robot, asyncio.TaskGroup() as tasks:

        async def stopped():
            await turning(stage)
            return await robot.stop()

        stop = tasks.create_task(stopped())
        with pytest.raises(MoveFailed) as failed:
            await robot.move(20.0)
        assert failed.value.moved is not None
        assert await stop == "armed"


async def test_a_cancelled_move_releases_its_lease(stage, armed):
    async with connected(stage) as robot, asyncio.TaskGroup() as tasks:
        move = tasks.create_task(robot.move(20.0))
        await turning(stage)
        move.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await move
        assert move.cancelled()
        assert (await robot.status()).leases == ()


async def test_closing_the_client_ends_its_leases(stage, armed):
    async with connected(stage) as robot:
        assert (await robot.drive(0.0, 0.0, lease_s=5.0))["in_command"]
        assert (await robot.status()).leases[0].owner == "socket"
    wait_until(lambda: not stage.robot.status().leases, "no lease is left")
    with pytest.raises(ClientError, match="closed"):
        await robot.status()


async def test_a_cancelled_call_does_not_disturb_the_next(stage):
    async with connected(stage) as robot:
        call = asyncio.gather(robot.params_list(), return_exceptions=True)
        await asyncio.sleep(0)
        call.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await call
        assert (await robot.status()).robot


async def test_a_call_to_a_silent_daemon_times_out(tmp_path):
    async def mute(reader, writer):
        await reader.read()
        writer.close()

    server = await asyncio.start_unix_server(mute, tmp_path / "mute.sock")
    async with server, Client(tmp_path / "mute.sock", timeout_s=0.2) as robot:
        with pytest.raises(ClientError, match=r"no answer within 0\.2 s"):
            await robot.status()


async def test_a_missing_daemon_is_named_with_its_path(tmp_path):
    with pytest.raises(ClientError, match=r"nobody\.sock: no daemon has this socket"):
        async with Client(tmp_path / "nobody.sock"):
            pass
