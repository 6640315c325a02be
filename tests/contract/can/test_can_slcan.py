# SPDX-License-Identifier: Apache-2.0
"""A CAN line on asyncio over an slcan adapter: real bytes on a pty, python-can's own driver."""

import pytest
from can_rig import TURN, spec_of
from loop_side import running, until
from scripted_odrive import CLOSED_LOOP, IDLE, Peer, living
from slcan_adapter import SlcanAdapter

from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import DriveState, EventKind


@pytest.fixture
async def adapter(tmp_path):
    return SlcanAdapter(tmp_path / "adapter")


@pytest.fixture
async def peer(adapter):
    async with living(Peer("slcan", (0,), adapter.address, adapter)) as peer:
        yield peer


async def turning(rig, peer):
    await rig.arm()
    assert rig.line.engine == "asyncio"
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()), "it is commanded to turn")


async def test_a_drive_is_armed_driven_read_and_switched_off(adapter, peer):
    async with running(spec_of(peer, 0)) as rig:
        await turning(rig, peer)
        assert "S6" in adapter.commands  # 500 kbit/s, before the channel is opened
        assert peer.axes[0].state == CLOSED_LOOP
        peer.axes[0].velocity_turns_s = 0.5
        await until(
            lambda: rig.loop.exchange.take_feedback(0).velocity_rad_s == pytest.approx(TURN / 2)
        )
        peer.axes[0].velocity_turns_s = 0.0
        await rig.line.disarm()
        await until(lambda: peer.axes[0].state == IDLE)
        await until(lambda: peer.axes[0].velocities()[-1] == 0.0)


async def test_the_end_of_the_line_stops_the_drive(peer):
    async with running(spec_of(peer, 0)) as rig:
        await turning(rig, peer)
    await until(lambda: peer.axes[0].state == IDLE)
    assert peer.axes[0].velocities()[-1] == 0.0


async def test_bytes_that_are_no_frames_are_counted_and_the_line_continues(adapter, peer):
    async with running(spec_of(peer, 0)) as rig:
        await turning(rig, peer)
        for garbage in (b"tXYZ\r", b"t0018001122\r", b"t\r", b"\a"):
            adapter.say(garbage)
            counted = rig.line.stats().errors.get("bad_frame", 0)
            received = rig.line.stats().exchanges
            await until(lambda received=received: rig.line.stats().exchanges > received + 20)
            more = rig.line.stats().errors.get("bad_frame", 0) > counted
            assert more or garbage == b"\a", garbage
        assert rig.states() == {DriveState.ARMED}
        assert rig.kinds().count(EventKind.LINE_OPEN) == 1


async def test_noise_that_its_driver_fails_on_closes_the_line_which_is_opened_again(adapter, peer):
    async with running(spec_of(peer, 0)) as rig:
        await turning(rig, peer)
        adapter.say(b"\xff\xfe\r")
        await until(lambda: rig.kinds().count(EventKind.LINE_OPEN) == 2)
        await until(lambda: peer.axes[0].state == IDLE)
        await rig.ready()


async def test_an_adapter_that_is_unplugged_comes_back_with_its_drives_disarmed(adapter, peer):
    async with running(spec_of(peer, 0)) as rig:
        await turning(rig, peer)
        adapter.pull()
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
        peer.axes[0].state = IDLE
        mark = len(peer.axes[0].velocities())
        adapter.plug()
        await rig.ready()
        assert rig.states() == {DriveState.READY}
        assert set(peer.axes[0].velocities()[mark:]) <= {0.0}


async def test_stop_all_stops_a_drive_that_no_program_drives(peer):
    peer.axes[0].state = CLOSED_LOOP
    assert await halt_line(spec_of(peer, 0)) == []
    assert peer.axes[0].state == IDLE
