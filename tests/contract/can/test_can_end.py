# SPDX-License-Identifier: Apache-2.0
"""End of a CAN line of either engine on a full bus: a lost power-off is sent again, or reported."""

import asyncio

import pytest
from can_rig import TURN, joints, spec_of
from can_rt_rig import arm, lively
from loop_side import running, until
from scripted_odrive import BUSES, IDLE, INPUT_VELOCITY, MODE, STATE, Peer, living

from motord_hal.fieldbus.ports import DriveState, EventKind

ENGINES = ["asyncio", "rt"]


def rig_on(bus, engine):
    return running(spec_of(bus, 0, joints=joints(0), engine=engine))


async def opened(rig, bus):
    await until(lambda: EventKind.LINE_OPEN in rig.kinds())
    bus.accept()


async def fill(rig, bus):
    """Fill the queue: read nothing from the bus until the line cannot send any more."""

    def full():
        bus.say()
        return rig.line.stats().errors.get("tx_full", 0) > 3

    await until(full)


def warnings_at_the_end(rig):
    return [e for e in rig.events if e.kind is EventKind.DRIVE_LEFT_ON]


@pytest.mark.parametrize("engine", ENGINES)
async def test_a_drive_that_cannot_be_switched_off_is_reported_by_name(bus, engine):
    async with rig_on(bus, engine) as rig:
        await opened(rig, bus)
        await arm(rig, bus)
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
        await fill(rig, bus)
    (warning,) = warnings_at_the_end(rig)
    assert "wheel0 not switched off at the end" in warning.text
    assert warning.joints == ("wheel0",)


@pytest.mark.parametrize("engine", ENGINES)
async def test_a_power_off_that_a_full_bus_did_not_take_is_sent_again(bus, engine):
    async def receive_late():
        await asyncio.sleep(0.1)
        while True:
            bus.receive()
            await asyncio.sleep(0.005)

    async with asyncio.TaskGroup() as group:
        async with rig_on(bus, engine) as rig:
            await opened(rig, bus)
            await lively(rig, bus, lambda: rig.states() == {DriveState.READY})
            await fill(rig, bus)
            bus.received.clear()
            receiving = group.create_task(receive_late())
        bus.receive()
        receiving.cancel()
    assert bus.states()[-1] == IDLE
    assert warnings_at_the_end(rig) == []


@pytest.mark.parametrize("kind", BUSES)
async def test_a_stopping_wheel_is_braked_until_it_loses_power(kind):
    async with living(Peer(kind, nodes=(0,))) as peer:
        axis = peer.axes[0]
        async with running(spec_of(peer, 0)) as rig:
            await rig.arm()
            axis.velocity_turns_s = 2.0
            rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
            await until(lambda: any(axis.velocities()))
            rig.loop.running = False
            await until(lambda: rig.states() == {DriveState.READY})
            mark = len(axis.received)
            assert axis.state != IDLE
        await until(lambda: axis.state == IDLE)
        sent = [command for command, _ in axis.received[mark:]]
        assert sent[: sent.index(STATE)].count(INPUT_VELOCITY) > 5


def cut(axis):
    axis.silent, axis.ignored = True, {STATE, INPUT_VELOCITY, MODE}


async def turning(rig, axis):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(axis.velocities()))


@pytest.mark.parametrize("kind", BUSES)
@pytest.mark.parametrize("unresponsive", [False, True])
async def test_a_power_off_that_a_cut_cable_lost_is_sent_again(kind, unresponsive):
    """A frame that the bus has taken need not reach the drive."""

    async def mend(axis):
        await until(lambda: not axis.ignored or len(axis.received) > mark + 10)
        axis.silent, axis.ignored = False, set()

    async with living(Peer(kind, nodes=(0,))) as peer, asyncio.TaskGroup() as group:
        axis = peer.axes[0]
        async with running(spec_of(peer, 0)) as rig:
            await turning(rig, axis)
            cut(axis)
            if unresponsive:
                await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
            mark = len(axis.received)
            group.create_task(mend(axis))
        await until(lambda: axis.state == IDLE)
    assert warnings_at_the_end(rig) == []


@pytest.mark.parametrize("kind", BUSES)
@pytest.mark.parametrize("unresponsive", [False, True])
async def test_a_drive_behind_a_cut_cable_is_reported(kind, unresponsive):
    async with living(Peer(kind, nodes=(0,))) as peer:
        axis = peer.axes[0]
        async with running(spec_of(peer, 0)) as rig:
            await turning(rig, axis)
            cut(axis)
            if unresponsive:
                await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
        (warning,) = warnings_at_the_end(rig)
        assert "wheel0 not switched off at the end" in warning.text
        assert "not confirmed" in warning.text
