# SPDX-License-Identifier: Apache-2.0
"""Registers by name, what is read back, and set-points and feedback in one exchange: against
scripted slaves."""

import math
from dataclasses import replace

import pytest
from loop_side import running, until
from modbus_rig import (
    FAULT_1,
    RPM,
    TARGET_1,
    TARGET_2,
    VELOCITY_1,
    hub_servo,
    spec_of,
)

from motord_hal.base.errors import DriveFault
from motord_hal.drives.profile import Register, RegisterType, Step
from motord_hal.fieldbus.ports import DriveState, EventKind
from motord_hal.modbus.codec import Function


async def test_a_register_is_read_by_name_in_si_while_the_line_cycles(rig, peer):
    peer.units[1].registers[0x20A1] = 2412
    await rig.ready()
    assert await rig.line.read_register("left1", "bus_voltage") == pytest.approx(24.12)
    with pytest.raises(LookupError):
        await rig.line.read_register("left1", "bus_volts")
    with pytest.raises(LookupError):
        await rig.line.read_register("nobody", "bus_voltage")
    assert rig.states() == {DriveState.READY}


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0])
async def test_a_register_that_motord_writes_is_not_written_by_name(rig, peer, value):
    await rig.ready()
    with pytest.raises(ValueError, match="motord itself"):
        await rig.line.write_register("left1", "control_word", value)
    with pytest.raises(ValueError, match="only be read"):
        await rig.line.write_register("left1", "bus_voltage", value)


def geared(register_max=500.0):
    """Return the hub servo with one more register, which a person may write."""
    left, right = hub_servo()
    gain = Register(
        name="gain", address=0x20A3, type=RegisterType.I16, scale=0.5, unit="", access="rw",
        minimum=-register_max, maximum=register_max, source="test",
    )  # fmt: skip
    profile = replace(left.profile, registers={**left.profile.registers, "gain": gain})
    return replace(left, profile=profile), replace(right, profile=profile)


async def test_a_register_is_written_and_read_back(peer):
    async with running(spec_of(peer, geared())) as rig:
        await rig.arm()
        assert await rig.line.write_register("left1", "gain", -2.6) == pytest.approx(-2.5)
        assert peer.written(0x20A3) == [0x10000 - 5]
        assert await rig.line.read_register("right1", "gain") == pytest.approx(-2.5)
        assert rig.states() == {DriveState.ARMED}
        for value in (500.5, math.nan, -math.inf):
            with pytest.raises(ValueError, match="not within"):
                await rig.line.write_register("left1", "gain", value)
        assert len(peer.written(0x20A3)) == 1


async def test_a_register_that_does_not_keep_its_value_is_an_error(peer):
    unit = peer.units[1]
    async with running(spec_of(peer, geared())) as rig:
        await rig.ready()
        unit.on_write = lambda address, value: unit.registers.update({0x20A3: 7})
        with pytest.raises(DriveFault, match="gain is 0x7"):
            await rig.line.write_register("left1", "gain", 4.0)
        assert rig.states() == {DriveState.READY}


async def test_registers_that_the_set_up_writes_are_read_back(peer):
    unit = peer.units[1]
    joints = geared()
    steps = (*joints[0].profile.configure, Step(register="gain", value=9))
    profile = replace(joints[0].profile, configure=steps)
    joints = tuple(replace(joint, profile=profile) for joint in joints)
    unit.on_write = lambda address, value: unit.registers.update({0x20A3: 8})
    async with running(spec_of(peer, joints)) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        assert "gain is 0x8" in rig.events[-1].text
        unit.on_write = None
        await rig.ready()


# ----------------------------------------------------------- writing and reading in one exchange
async def test_a_drive_with_function_23_is_written_and_read_in_one_exchange(peer):
    profile = replace(hub_servo()[0].profile, read_write_function=23)
    joints = tuple(replace(joint, profile=profile) for joint in hub_servo())
    async with running(spec_of(peer, joints)) as rig:
        await rig.arm()
        peer.units[1].registers[VELOCITY_1] = 300
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM, 1: 60 * RPM}
        await until(lambda: 60 in peer.written(TARGET_1))
        await until(lambda: rig.loop.exchange.take_feedback(0).velocity_rad_s > 0)
        assert peer.written(TARGET_2)[-1] == 0x10000 - 120
        both = [r for r in peer.requests() if r.function is Function.READ_WRITE]
        assert {r.write_address for r in both} == {TARGET_1}
        cyclic = [
            r
            for r in peer.requests()
            if r.function is Function.READ_HOLDING and r.address <= FAULT_1 < r.address + r.count
        ]
        assert not cyclic
