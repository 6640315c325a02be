# SPDX-License-Identifier: Apache-2.0
"""Lines that are interrupted while they bring their drives to rest, against scripted drives."""

import asyncio
import contextlib
from dataclasses import replace

import pytest
from can_rig import TURN
from can_rig import spec_of as can_spec_of
from loop_side import PATIENT_S, running, until
from modbus_rig import (
    CONTROL,
    OFF,
    QUICK_STOP,
    RPM,
    TARGET_1,
    VELOCITY_1,
    hub_servo,
    registers_of,
    spec_of,
)
from scripted_gateway import GATEWAYS
from scripted_odrive import BUSES, CLOSED_LOOP, IDLE, INPUT_VELOCITY, STATE, Peer, living
from scripted_slave import Unit

from motord.config.drives.load import find_profile
from motord_hal.base.clock import now_ns
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import DriveState, JointSpec
from motord_hal.realtime.drive_state import DriveRules

CYCLES_SEEN = 5
"""More set-points than can still have been in transit when the line had to end."""


@pytest.fixture(params=BUSES)
async def bus(request):
    async with living(Peer(request.param)) as peer:
        yield peer


async def test_a_disarming_whose_caller_was_cancelled_still_takes_the_power(peer):
    mute = [
        replace(joint, profile=replace(joint.profile, enabled=None)) for joint in hub_servo()
    ]  # a drive that reports that it is enabled would be sent the power-off again
    async with running(spec_of(peer, mute)) as rig:
        await rig.arm()
        sent = len(peer.written(CONTROL))
        disarming = asyncio.create_task(rig.line.disarm())
        await until(lambda: rig.states() == {DriveState.READY})
        disarming.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await disarming
        await until(lambda: OFF in peer.written(CONTROL)[sent:])


async def test_a_line_that_ends_while_a_modbus_drive_is_stopping_lets_it_come_to_rest(peer):
    peer.units[1].registers[VELOCITY_1] = 600
    async with running(spec_of(peer, hub_servo()), in_haste=True) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
        await until(lambda: 60 in peer.written(TARGET_1))
        rig.loop.running = False
        await until(lambda: peer.written(CONTROL)[-1] == QUICK_STOP)
        until_the_end = len(peer.received)
    after = [received.request for received in peer.received[until_the_end:]]
    off = next(n for n, one in enumerate(after) if one.address == CONTROL and OFF in one.values)
    assert sum(one.address == TARGET_1 for one in after[:off]) >= CYCLES_SEEN


@pytest.mark.parametrize("peer", ["asyncio", *GATEWAYS], indirect=True)
async def test_a_modbus_drive_that_is_still_stopping_is_not_armed(peer, monkeypatch):
    ends = DriveRules.end_stopping  # a stop ends by rest alone: its time never passes
    monkeypatch.setattr(
        DriveRules, "end_stopping", lambda one, _, at_rest: ends(one, 0, at_rest=at_rest)
    )
    peer.units[1].registers[VELOCITY_1] = 600
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.arm()
        rig.loop.running = False
        await until(lambda: peer.written(CONTROL)[-1] == QUICK_STOP)
        rig.loop.running = True
        await until(lambda: now_ns() - rig.loop.put_ns < PATIENT_S * 1e9)
        with pytest.raises(HalError, match="still stopping"):
            await rig.line.arm()
        assert rig.states() == {DriveState.READY}
        peer.units[1].registers[VELOCITY_1] = 0
        await until(lambda: peer.written(CONTROL)[-1] == OFF)
        await rig.arm()


@pytest.mark.parametrize(
    ("name", "run", "speed", "velocity"),
    [("bld-305s", 0x66, 0x56, 0x5F), ("blvd20km", 0x7D, 0x481, 0xCF)],
)
async def test_the_brake_of_a_quick_stop_holds_until_the_wheel_rests(
    peer, name, run, speed, velocity
):
    profile = find_profile(name)
    unit = peer.units[1] = Unit(registers_of(name))
    brake = next(step.value for step in profile.quick_stop if step.register == "run_command")
    wheel = JointSpec(index=0, name="wheel", profile=profile, unit=1)
    async with running(spec_of(peer, [wheel])) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
        await until(lambda: unit.registers[speed] > 0)
        unit.registers[velocity] = 900
        rig.loop.running = False
        await until(lambda: peer.written(run)[-1] == brake)
        braking = len(peer.received)
        await until(lambda: wrote(peer, braking, speed) >= CYCLES_SEEN)
        assert unit.registers[run] == brake
        unit.registers[velocity] = 0
        await until(lambda: unit.registers[run] == profile.channels[1].direction.rest)


def wrote(peer, since, address):
    """Return how often a register was written since then."""
    return sum(
        received.request.address == address and bool(received.request.values)
        for received in peer.received[since:]
    )


async def test_a_line_that_ends_while_a_can_drive_is_stopping_lets_it_come_to_rest(bus):
    axis = bus.axes[0]
    async with running(can_spec_of(bus)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
        await until(lambda: any(axis.velocities()))
        axis.velocity_turns_s = 1.0
        rig.loop.running = False
        await until(lambda: rig.states() == {DriveState.READY})
        until_the_end = len(axis.received)
    await until(lambda: axis.state == IDLE)
    after = [command for command, _ in axis.received[until_the_end:]]
    assert after[: after.index(STATE)].count(INPUT_VELOCITY) >= CYCLES_SEEN
    assert CLOSED_LOOP not in axis.states()[-1:]


SLOW_RAD_S = 0.02
"""Limit of rest. The wheels here creep faster than this, but slower than any usual limit."""


async def test_a_modbus_drive_keeps_its_power_until_it_is_as_slow_as_the_robot_file_demands(peer):
    peer.units[1].registers[VELOCITY_1] = 5  # 0.5 rpm: 0.05 rad/s
    async with running(spec_of(peer, hub_servo(), rest_velocity_rad_s=SLOW_RAD_S)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
        await until(lambda: 60 in peer.written(TARGET_1))
        rig.loop.running = False
        await until(lambda: peer.written(CONTROL)[-1] == QUICK_STOP)
        stopping = len(peer.received)
        await until(lambda: wrote(peer, stopping, TARGET_1) >= CYCLES_SEEN)
        assert peer.written(CONTROL)[-1] == QUICK_STOP
        peer.units[1].registers[VELOCITY_1] = 1  # 0.01 rad/s
        await until(lambda: peer.written(CONTROL)[-1] == OFF)


async def test_a_can_drive_keeps_its_power_until_it_is_as_slow_as_the_robot_file_demands(bus):
    axis = bus.axes[0]
    async with running(can_spec_of(bus, rest_velocity_rad_s=SLOW_RAD_S)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
        await until(lambda: any(axis.velocities()))
        axis.velocity_turns_s = 0.05 / TURN
        rig.loop.running = False
        await until(lambda: rig.states() == {DriveState.READY})
        stopping = len(axis.received)
        await until(lambda: sent_velocities(axis, stopping) >= CYCLES_SEEN)
        assert axis.state == CLOSED_LOOP
        axis.velocity_turns_s = 0.01 / TURN
        await until(lambda: axis.state == IDLE)


def sent_velocities(axis, since):
    """Return how often the axis was sent a velocity since then."""
    return [command for command, _ in axis.received[since:]].count(INPUT_VELOCITY)
