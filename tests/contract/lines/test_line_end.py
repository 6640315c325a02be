# SPDX-License-Identifier: Apache-2.0
"""Serial lines that end while a drive is disturbed: it gets its stop, or it is reported."""

import asyncio
import dataclasses

import pytest
from loop_side import running, until
from modbus_rig import ENGINES, mute, registers_of, spec_of
from scripted_slave import ScriptedSlave, Unit

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec

TARGET, ENABLE, STATUS = 0x0200, 0x0201, 0x0202
ON, OFF = 1, 0
WHEEL = JointSpec(index=0, name="wheel", profile=find_profile("speed-register"), unit=1)


@pytest.fixture(params=ENGINES)
def engine(request):
    return request.param


@pytest.fixture
async def peer(tmp_path, engine):
    peer = ScriptedSlave(tmp_path / "port", engine=engine)
    unit = peer.units[1] = Unit(registers_of("speed-register"))

    def switch(address, value):
        if address == ENABLE:
            unit.registers[STATUS] = value

    unit.on_write = switch
    yield peer
    peer.pull()


async def set_off(rig, unit):
    rig.loop.velocity_rad_s = {0: 20.0}
    await rig.drive(lambda: unit.registers[TARGET] > 0, "it drives")
    assert unit.registers[ENABLE] == ON


@pytest.mark.parametrize("lost", [3, 4, 6])
async def test_a_drive_that_is_unreachable_for_a_moment_at_the_end_is_switched_off(peer, lost):
    unit = peer.units[1]
    async with running(spec_of(peer, [WHEEL]), in_haste=True) as rig:
        await set_off(rig, unit)
        unit.loses = lost
    assert (unit.registers[TARGET], unit.registers[ENABLE]) == (0, OFF)
    assert EventKind.DRIVE_LEFT_ON not in rig.kinds()


async def test_an_unresponsive_drive_that_answers_during_the_end_is_switched_off(peer):
    unit = peer.units[1]
    async with running(spec_of(peer, [WHEEL]), in_haste=True) as rig:
        await set_off(rig, unit)
        unit.silent = True
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
        unit.silent, unit.loses = False, 4
    assert (unit.registers[TARGET], unit.registers[ENABLE]) == (0, OFF)


async def test_a_drive_that_stays_unreachable_until_the_end_is_named(peer):
    unit = peer.units[1]
    async with running(spec_of(peer, [WHEEL]), in_haste=True) as rig:
        await set_off(rig, unit)
        unit.silent = True
    assert rig.kinds()[-1] is EventKind.DRIVE_LEFT_ON
    assert "wheel not switched off at the end" in rig.events[-1].text


@pytest.mark.parametrize("later_s", [0.0, 0.02, 0.05])
async def test_a_missing_drive_does_not_delay_the_stop_of_its_neighbour(peer, later_s):
    """The wait for one reply is longer than the time that the line has for its end."""
    other = peer.units[2] = Unit(registers_of("speed-register"))

    def switch(address, value):
        if address == ENABLE:
            other.registers[STATUS] = value

    other.on_write = switch
    wheels = [
        dataclasses.replace(WHEEL, index=n, name=f"wheel{n}", unit=n + 1, reply_timeout_s=0.6)
        for n in range(2)
    ]
    async with running(spec_of(peer, wheels)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 20.0, 1: 20.0}
        await until(lambda: all(peer.units[unit].registers[TARGET] > 0 for unit in (1, 2)))
        peer.units[1].silent = True
        sent = len(peer.requests(1))
        await until(lambda: len(peer.requests(1)) > sent)
        await asyncio.sleep(later_s)  # the end falls into the exchange with the missing drive
        mark = len(peer.received)
    after = [received.request for received in peer.received[mark:]]
    assert peer.units[2].registers[TARGET] == 0
    assert any(one.unit == 2 and one.address == ENABLE and OFF in one.values for one in after)


async def test_a_drive_whose_replies_are_lost_is_switched_off_at_the_end(peer):
    unit = peer.units[1]
    async with running(spec_of(peer, [WHEEL]), in_haste=True) as rig:
        await set_off(rig, unit)
        mute(peer)
    assert (unit.registers[TARGET], unit.registers[ENABLE]) == (0, OFF)
    assert "wheel not switched off at the end" in rig.events[-1].text


LEARNT_AFTER = 10
"""Number of requests to a drive after which the line knows how long its answers take."""


def slow(peer, reply, after_s=0.018):
    """From now on send what `reply` makes of each honest reply, late by this time."""
    peer.tricks.clear()

    def later(request, honest):
        peer.tricks.append(later)
        return [(after_s, reply(honest))]

    peer.tricks.append(later)


@pytest.mark.parametrize(("drives", "torn_after_s"), [(1, 0.018), (1, 0.07), (8, 0.018)])
async def test_each_drive_is_sent_its_whole_power_off_even_when_no_reply_arrives(
    tmp_path, engine, drives, torn_after_s
):
    """Each write that is not answered costs a good part of the time that the end has."""
    peer = ScriptedSlave(tmp_path / "port", engine=engine)
    profile, units = find_profile("bld-305s"), range(1, drives + 1)
    peer.units = {unit: Unit(registers_of("bld-305s")) for unit in units}
    speed, run = (profile.registers[name].address for name in ("target_velocity", "run_command"))
    wheels = [JointSpec(index=n - 1, name=f"w{n}", profile=profile, unit=n) for n in units]
    async with running(spec_of(peer, wheels), in_haste=True) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, dict.fromkeys(range(drives), 20.0)
        await until(lambda: all(peer.written(speed, unit)[-1] > 0 for unit in units))
        slow(peer, lambda honest: honest)
        received = len(peer.received)
        await until(lambda: len(peer.received) >= received + LEARNT_AFTER * drives)
        slow(peer, lambda honest: honest[:-1], torn_after_s)
        mark = len(peer.received)
    peer.pull()
    sent = {(h.request.unit, h.request.address, *h.request.values) for h in peer.received[mark:]}
    assert {(unit, register, 0) for unit in units for register in (speed, run)} <= sent
    assert "not switched off at the end" in rig.events[-1].text
