# SPDX-License-Identifier: Apache-2.0
"""Drives on a CAN bus whose daemon has died are stopped by the next program."""

import pytest
from can_rig import spec_of
from scripted_odrive import BUSES, CLOSED_LOOP, IDLE, INPUT_VELOCITY, STATE, Peer, living

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.halt import halt_line


@pytest.fixture(params=BUSES)
async def peer(request):
    async with living(Peer(request.param, nodes=(0, 3))) as peer:
        for axis in peer.axes.values():
            axis.state = CLOSED_LOOP
        yield peer


async def test_every_drive_is_sent_zero_and_then_loses_its_power(peer):
    assert await halt_line(spec_of(peer, 0, 3)) == []
    for axis in peer.axes.values():
        assert axis.state == IDLE
        assert set(axis.velocities()) == {0.0}
        sent = [command for command, _ in axis.received]
        assert sent.index(INPUT_VELOCITY) < sent.index(STATE)
        assert CLOSED_LOOP not in axis.states()


async def test_a_drive_that_keeps_turning_is_switched_off_and_one_that_stays_enabled_is_reported(
    peer,
):
    peer.axes[0].velocity_turns_s = 2.0
    peer.axes[3].ignored.add(STATE)
    problems = await halt_line(spec_of(peer, 0, 3))
    assert peer.axes[0].state == IDLE
    assert problems == ["wheel3: reports that it is still enabled"]


async def test_a_silent_drive_is_switched_off_and_reported(peer):
    peer.axes[0].silent = True
    (problem,) = await halt_line(spec_of(peer, 0, 3))
    assert "wheel0" in problem
    assert "no heartbeat frame" in problem
    assert peer.axes[0].state == peer.axes[3].state == IDLE


async def test_a_missing_bus_is_an_error(peer):
    with pytest.raises(PortError, match="there is no CAN interface"):
        await halt_line(spec_of(peer, 0, port="socketcan:nothing0"))
