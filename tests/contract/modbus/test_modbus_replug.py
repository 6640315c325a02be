# SPDX-License-Identifier: Apache-2.0
"""Modbus lines of both engines whose port disappears and comes back: what is reported and sent."""

import pytest
from loop_side import running, until
from modbus_rig import (
    CONTROL,
    ENGINES,
    OFF,
    QUICK_STOP,
    RPM,
    TARGET_1,
    hub_servo,
    registers_of,
    single_writes,
    spec_of,
)
from scripted_gateway import GATEWAYS, peer_on
from scripted_slave import Unit

from motord_hal.fieldbus.ports import DriveState, EventKind, LineState


@pytest.fixture(params=[*ENGINES, *GATEWAYS])
async def peer(tmp_path, request):
    peer = peer_on(request.param, tmp_path)
    peer.units = {1: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


async def test_a_pulled_port_is_reported_once_and_comes_back_disarmed(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    peer.pull()
    await until(lambda: rig.line.state is LineState.CLOSED)
    await until(lambda: EventKind.LINE_LOST in rig.kinds())
    mark = len(peer.received)
    peer.plug()
    await rig.ready()
    assert all(
        not any(h.request.values) for h in peer.received[mark:] if h.request.address == TARGET_1
    )
    assert rig.kinds()[2:] == [
        EventKind.LINE_LOST,
        EventKind.LINE_OPEN,
        EventKind.DRIVE_READY,
    ]
    assert rig.line.stats().reopened == 1


async def test_a_drive_that_moved_when_its_port_was_lost_is_stopped_before_it_is_set_up(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    peer.pull()
    await until(lambda: rig.line.state is LineState.CLOSED)
    mark = len(peer.received)
    peer.plug()
    await rig.ready()
    assert single_writes(peer, mark)[0] in {(CONTROL, QUICK_STOP), (CONTROL, OFF)}


async def test_an_armed_drive_is_stopped_after_a_replug_even_when_it_does_not_answer(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    peer.pull()
    await until(lambda: rig.line.state is LineState.CLOSED)
    peer.units[1].silent = True
    mark = len(peer.received)
    peer.plug()

    def sent(address):
        since = [received.request for received in peer.received[mark:]]
        return [one.values[0] for one in since if one.address == address and one.values]

    await until(lambda: QUICK_STOP in sent(CONTROL))
    await until(lambda: sent(TARGET_1) != [])
    assert set(sent(TARGET_1)) == {0}
    assert rig.line.drive_states["left1"] is not DriveState.READY


async def test_an_absent_port_is_reported_once_and_opened_when_it_comes(peer):
    peer.pull()
    async with running(spec_of(peer, hub_servo())) as rig:
        await until(lambda: rig.kinds() == [EventKind.LINE_LOST])
        assert any(
            w in rig.events[0].text for w in ("no such port", "No such file", "no server listens")
        )
        pause_s = rig.line._backoff._next_s
        await until(lambda: rig.line._backoff._next_s > pause_s, "it has tried again")
        assert rig.kinds() == [EventKind.LINE_LOST]
        peer.plug()
        await rig.ready()
