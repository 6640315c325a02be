# SPDX-License-Identifier: Apache-2.0
"""Lines whose drive answers what no drive should: the line handles each answer as an error, and
the power-off is sent at the end."""

import asyncio

import pytest
from loop_side import running, until
from modbus_rig import (
    CONTROL,
    ENABLE,
    ENGINES,
    OFF,
    QUICK_STOP,
    RPM,
    TARGET_1,
    hub_servo,
    spec_of,
)
from scripted_gateway import GATEWAYS

from motord_hal.base.errors import NoReply
from motord_hal.fieldbus.ports import DriveState
from motord_hal.modbus.codec import Function, Request, build_exception
from motord_hal.modbus.tcp_guard import GatewayClient


async def set_off(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))


def always(peer, trick):
    """From now on send what `trick` makes of each honest reply."""

    def again(request, honest):
        peer.tricks.append(again)
        return trick(request, honest)

    peer.tricks.append(again)


def refuse_with_zero(request, honest):
    return [(0.0, build_exception(request.unit, request.function, 0))]


async def test_a_line_outlives_exceptions_with_code_zero_and_stops_its_drive(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await set_off(rig, peer)
        always(peer, refuse_with_zero)
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
        await until(lambda: QUICK_STOP in peer.written(CONTROL))
        assert any("exception 0" in event.text for event in rig.events)
        peer.tricks.clear()
        await rig.ready()


async def test_a_drive_that_answers_with_exceptions_of_code_zero_is_switched_off_at_the_end(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await set_off(rig, peer)
        always(peer, refuse_with_zero)
    assert peer.written(CONTROL)[-1] == OFF
    assert "left1, right1 not switched off at the end" in rig.events[-1].text


async def test_a_write_that_is_refused_with_code_zero_is_not_done(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.ready()
        unit = peer.units[1]

        def refuse_enabling(request, honest):
            if request.address == CONTROL and request.values == (ENABLE,):
                unit.registers[CONTROL] = OFF
                return refuse_with_zero(request, honest)
            return [(0.0, honest)]

        always(peer, refuse_enabling)
        with pytest.raises(Exception, match="exception 0"):
            await rig.line.arm()
        assert DriveState.ARMED not in rig.states()


@pytest.mark.parametrize("peer", ["asyncio", *GATEWAYS], indirect=True)
async def test_a_bug_in_motord_does_not_keep_the_power_on(peer, monkeypatch):
    with pytest.raises(ExceptionGroup) as raised:
        async with running(spec_of(peer, hub_servo())) as rig:
            await set_off(rig, peer)
            (drive,) = rig.line._drives

            def mistaken(*_):
                raise IndexError("a bug")

            monkeypatch.setattr(drive, "_publish", mistaken)
            await asyncio.wait([rig.task])
    assert peer.written(CONTROL)[-1] == OFF
    assert raised.group_contains(IndexError)


@pytest.mark.parametrize("peer", [*ENGINES, "rtu-over-tcp"], indirect=True)
async def test_a_line_that_is_never_silent_does_not_block_a_power_off(peer):
    async def babble():
        while True:
            getattr(peer, "send_raw", peer.send)(b"\x55")
            await asyncio.sleep(0.001)

    async with asyncio.TaskGroup() as group:
        async with running(spec_of(peer, hub_servo(), gap_s=0.02)) as rig:
            await set_off(rig, peer)
            babbling = group.create_task(babble())
            await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
            await until(lambda: QUICK_STOP in peer.written(CONTROL))
        assert peer.written(CONTROL)[-1] == OFF
        babbling.cancel()


@pytest.mark.parametrize("peer", ["modbus-tcp"], indirect=True)
async def test_a_gateway_that_does_not_answer_in_modbus_does_not_block_a_power_off(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await set_off(rig, peer)
        always(peer, lambda request, honest: peer.send_raw(b"no Modbus") or [])
    assert peer.written(CONTROL)[-1] == OFF


@pytest.mark.parametrize("peer", ["modbus-tcp"], indirect=True)
async def test_junk_that_comes_before_a_power_off_does_not_block_it(peer):
    """The junk comes while the power-off waits for the answer of an earlier request."""
    client = GatewayClient(spec_of(peer, hub_servo()))
    await client.open()
    peer.units[1].silent = True
    with pytest.raises(NoReply):
        await client.exchange(Request(1, Function.READ_HOLDING, CONTROL, count=1), 0.1)
    off = Request(1, Function.WRITE_SINGLE, CONTROL, values=(OFF,))
    peer.units[1].silent = False
    sending = asyncio.ensure_future(client.exchange(off, 5.0, urgent=True))
    await asyncio.sleep(0)  # the power-off waits
    peer.send_raw(b"no Modbus")
    await sending
    assert peer.written(CONTROL) == [OFF]
    client.close()
