# SPDX-License-Identifier: Apache-2.0
"""Drives on CAN that turn when a line meets them: how long they are braked, and what is reported of
their rest. The scripted drives send raw frames."""

import asyncio
import contextlib
import math

import pytest
from can_rig import TURN, spec_of
from loop_side import running, until
from scripted_odrive import BUSES, CLOSED_LOOP, IDLE, INPUT_VELOCITY, STATE, Peer, living

from motord_hal.fieldbus.ports import REST_VELOCITY_RAD_S, DriveState

SLOWLY = 0.985
"""Part of its speed that a wheel keeps after each stop: it needs more than 2 s to rest."""
SPEED_TURNS_S = 2.0


@pytest.fixture(params=BUSES)
async def peer(request):
    async with living(Peer(request.param)) as peer:
        peer.axes[0].state, peer.axes[0].velocity_turns_s = CLOSED_LOOP, SPEED_TURNS_S
        yield peer


def logged(rig):
    return " ".join(event.text for event in rig.events)


@contextlib.asynccontextmanager
async def braking(axis):
    """Let each stop that the axis receives make its wheel a little slower."""

    async def follow():
        stops = len(axis.velocities())
        while True:
            for _ in range(len(axis.velocities()) - stops):
                axis.velocity_turns_s *= SLOWLY
            stops = len(axis.velocities())
            await asyncio.sleep(0.002)

    async with asyncio.TaskGroup() as group:
        task = group.create_task(follow())
        try:
            yield
        finally:
            task.cancel()


def released_at_rest(axis, mark=0):
    """Whether no power-off came before the stops that bring the wheel to rest."""
    commands = [command for command, _ in axis.received[mark:]]
    stops = commands[: commands.index(STATE)].count(INPUT_VELOCITY)
    return SPEED_TURNS_S * math.tau * SLOWLY**stops < REST_VELOCITY_RAD_S


async def test_a_wheel_that_gets_slower_is_braked_until_it_rests(peer):
    axis = peer.axes[0]
    async with running(spec_of(peer, 0)) as rig, braking(axis):
        await rig.ready()
        assert released_at_rest(axis)
        assert set(axis.velocities()) == {0.0}
        assert "braked until it was at rest" in logged(rig)


@pytest.mark.parametrize(
    ("speed_turns_s", "words"),
    [
        (SPEED_TURNS_S, "released while it still turned at 13 rad/s"),
        (math.nan, "cannot see whether it turns"),
    ],
)
async def test_a_wheel_that_is_not_seen_to_slow_down_is_released_and_never_called_at_rest(
    peer, speed_turns_s, words
):
    axis = peer.axes[0]
    axis.velocity_turns_s = speed_turns_s
    async with running(spec_of(peer, 0)) as rig:
        await rig.ready()
        assert len(axis.velocities()) > 2
        assert axis.states()[0] == IDLE
        assert words in logged(rig)
        assert "at rest" not in logged(rig)


async def test_a_turning_drive_that_answers_again_is_braked_before_it_is_released(peer):
    axis = peer.axes[0]
    axis.state, axis.velocity_turns_s = IDLE, 0.0
    async with running(spec_of(peer, 0)) as rig:
        await rig.arm()
        rig.loop.velocity_rad_s = {0: TURN}
        await rig.drive(lambda: axis.velocities()[-1] > 0.0, "it is driven")
        axis.velocity_turns_s = SPEED_TURNS_S
        axis.silent = True
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "it is silent")
        rig.loop.enabled = False
        mark, axis.silent = len(axis.received), False
        async with braking(axis):
            await rig.ready()
        assert released_at_rest(axis, mark)
        assert "braked until it was at rest" in logged(rig)
