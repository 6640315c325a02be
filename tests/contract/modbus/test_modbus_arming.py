# SPDX-License-Identifier: Apache-2.0
"""When a Modbus line arms and when it refuses to, on both engines and over all media."""

import asyncio

import pytest
from loop_side import PATIENT_S, running, until
from modbus_rig import CONTROL, ENABLE, FAULT_1, OFF, hub_servo, registers_of, spec_of
from scripted_slave import Unit

from motord.config.drives.load import find_profile
from motord_hal.base.clock import now_ns
from motord_hal.base.errors import DriveFault, HalError
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec


async def test_arming_fails_when_a_drive_does_not_report_it_is_enabled(peer):
    def stay_off(address, value):
        if (address, value) == (CONTROL, ENABLE):
            peer.units[2].registers[CONTROL] = OFF

    peer.units[2].on_write = stay_off
    async with running(spec_of(peer, (*hub_servo(1), *hub_servo(2, first=2)))) as rig:
        await rig.ready()
        with pytest.raises(DriveFault, match="control_word"):
            await rig.line.arm()
        await until(lambda: peer.written(CONTROL, 1)[-1] == peer.written(CONTROL, 2)[-1] == OFF)
        assert DriveState.ARMED not in rig.states()


async def test_a_cancelled_arming_leaves_nothing_armed(rig, peer):
    await rig.ready()
    peer.units[1].on_write = lambda address, value: peer.units[1].registers.update({CONTROL: OFF})
    task = asyncio.ensure_future(rig.line.arm())
    await until(lambda: ENABLE in peer.written(CONTROL))
    peer.units[1].on_write = None
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await until(lambda: peer.written(CONTROL)[-1] == OFF)
    await rig.ready()


async def held_up(rig):
    """Stop the loop's set-points, and wait until the newest ones are old."""
    await rig.ready()
    rig.loop.running = False
    await until(lambda: now_ns() - rig.loop.put_ns > PATIENT_S * 1e9)


async def arming_while_held_up(rig):
    """Return a task that has begun to arm, and waits for fresh set-points."""
    await held_up(rig)
    arming = asyncio.ensure_future(rig.line.arm())
    await asyncio.sleep(0)
    return arming


async def test_arming_without_fresh_set_points_is_refused(rig, peer):
    await held_up(rig)
    with pytest.raises(HalError, match="no fresh set-points"):
        await rig.line.arm()
    assert DriveState.ARMED not in rig.states()


async def test_arming_waits_for_a_delayed_loop(rig, peer):
    arming = await arming_while_held_up(rig)
    assert not arming.done()
    rig.loop.running = True
    await arming
    assert rig.states() == {DriveState.ARMED}


async def test_a_drive_that_reports_a_fault_while_arming_waits_is_not_armed(rig, peer):
    arming = await arming_while_held_up(rig)
    peer.units[1].registers[FAULT_1] = 2
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds() or arming.done())
    rig.loop.running = True
    with pytest.raises(HalError):
        await arming
    assert ENABLE not in peer.written(CONTROL)


async def test_a_line_that_is_lost_while_arming_waits_is_not_armed(rig, peer):
    arming = await arming_while_held_up(rig)
    rig.task.cancel()
    with pytest.raises(HalError):
        await arming
    assert ENABLE not in peer.written(CONTROL)


async def test_a_slow_line_is_given_the_time_it_needs_to_arm(peer):
    peer.units = {n: Unit(registers_of("bld-305s")) for n in (1, 2, 3)}
    profile = find_profile("bld-305s")
    joints = [JointSpec(index=n, name=f"mill{n}", profile=profile, unit=n) for n in (1, 2, 3)]

    def slow(request, honest):
        peer.tricks.append(slow)
        return [(0.019, honest)]

    peer.tricks.append(slow)
    async with running(spec_of(peer, joints, baudrate=9600, cycle_hz=1000.0)) as rig:
        await rig.arm()
