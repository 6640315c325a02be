# SPDX-License-Identifier: Apache-2.0
"""The line against drives that keep turning, start again or are enabled when they must not be."""

import asyncio
import errno
import os
import time

import pytest
from _motord_rt import lib
from loop_side import GENEROUS_S, running, until
from modbus_rig import (
    CONTROL,
    ENABLE,
    ENGINES,
    OFF,
    QUICK_STOP,
    RPM,
    TARGET_1,
    TARGET_2,
    WATCHDOG,
    hub_servo,
    mute,
    registers_of,
    spec_of,
)
from scripted_slave import ScriptedSlave, Unit

from motord.config.drives.load import find_profile
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec
from motord_hal.modbus.codec import Function
from motord_hal.realtime import exchange

DUTY, DUTY_WATCHDOG = 0x0100, 0x0110
SPEED, RUN = 0x0056, 0x0066
FORWARD, REVERSE, REST = 1, 2, 0


@pytest.fixture(params=ENGINES)
async def peer(tmp_path, request):
    peer = ScriptedSlave(tmp_path / "port", engine=request.param)
    peer.units = {1: Unit(registers_of("zlac8015d")), 2: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


def single(name):
    return JointSpec(index=0, name="wheel", profile=find_profile(name), unit=1)


async def set_off(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))


async def test_a_drive_whose_replies_are_lost_is_stopped(rig, peer):
    await set_off(rig, peer)
    mute(peer)
    await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
    await until(lambda: QUICK_STOP in peer.written(CONTROL))
    await until(lambda: peer.written(TARGET_1)[-1] == peer.written(TARGET_2)[-1] == 0)
    peer.tricks.clear()
    await rig.ready()
    assert ENABLE not in peer.written(CONTROL)[peer.written(CONTROL).index(QUICK_STOP) :]


async def test_a_drive_that_refuses_its_set_points_is_stopped(rig, peer):
    await set_off(rig, peer)
    peer.units[1].refuses = {TARGET_1}
    await until(lambda: QUICK_STOP in peer.written(CONTROL))
    assert DriveState.ARMED not in rig.states()
    peer.units[1].refuses = set()
    await rig.ready()
    assert peer.written(TARGET_1)[-1] == 0


async def stopped_while_it_refuses(rig, peer, stop):
    """Stop a drive that refuses the first write of its power-off; wait until it has no power."""
    refused, command = 8602, 8501
    peer.units[1].refuses = {refused}
    mark = len(peer.written(command))
    await stop(rig)
    await until(lambda: 0 in peer.written(command)[mark:], "it loses its power")


async def disarmed(rig):
    with pytest.raises(HalError):
        await rig.line.disarm()


async def not_enabled(rig):
    rig.loop.enabled = False


@pytest.mark.parametrize("stop", [disarmed, not_enabled])
async def test_a_drive_that_refuses_one_write_of_its_power_off_gets_the_others(peer, stop):
    registers = registers_of("altivar")
    states = {0: 0x40, 6: 0x21, 7: 0x23, 15: 0x27, 11: 0x07}

    def on_write(address, value):
        if address == 8501:
            registers[3201] = states.get(value & 0xFF, 0x40)

    registers[7121] = 0
    peer.units = {1: Unit(registers, on_write)}
    async with running(spec_of(peer, [single("altivar")])) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 50.0}
        await until(lambda: any(peer.written(8602)))
        await stopped_while_it_refuses(rig, peer, stop)
        assert registers[3201] == 0x40


async def test_an_unresponsive_drive_that_was_never_armed_is_only_read(rig, peer):
    await rig.ready()
    mute(peer)
    await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
    mark = len(peer.received)
    await until(lambda: len(peer.received) > mark + 3)
    assert {h.request.function for h in peer.received[mark:]} == {Function.READ_HOLDING}


async def test_no_drive_is_enabled_with_an_old_set_point_in_its_register(rig, peer):
    await rig.ready()
    peer.units[1].registers[TARGET_1] = 60
    peer.units[1].refuses = {TARGET_1}
    with pytest.raises(HalError):
        await rig.line.arm()
    assert ENABLE not in peer.written(CONTROL)
    assert DriveState.ARMED not in rig.states()


def set_up_again(peer, watchdog):
    """Return whether the watchdog was written again (on a busy machine more than once)."""
    written = peer.written(watchdog)
    return len(written) > 1 and set(written) == {500}


async def test_a_drive_that_has_lost_its_watchdog_unseen_is_set_up_again(rig, peer):
    await rig.ready()
    peer.units[1].registers[WATCHDOG] = 0
    await until(lambda: set_up_again(peer, WATCHDOG))
    await rig.ready()
    assert EventKind.DRIVE_WARNING in rig.kinds()


async def test_an_armed_drive_that_has_lost_its_watchdog_is_disarmed(peer):
    peer.units[1] = Unit(registers_of("duty-register"))
    async with running(spec_of(peer, [single("duty-register")])) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
        await until(lambda: 50 in peer.written(DUTY))
        peer.units[1].registers[DUTY_WATCHDOG] = 0
        await until(lambda: set_up_again(peer, DUTY_WATCHDOG))
        await rig.ready()
        assert peer.written(DUTY)[-1] == 0


async def test_no_drive_is_enabled_without_its_watchdog(rig, peer):
    await rig.ready()
    peer.units[1].on_write = lambda *_: peer.units[1].registers.update({WATCHDOG: 0})
    with pytest.raises(HalError):
        await rig.line.arm()
    assert ENABLE not in peer.written(CONTROL)


async def test_a_drive_that_enables_itself_is_switched_off_and_reported_once(rig, peer):
    await rig.ready()
    offs = len(peer.written(CONTROL))

    def stays_on(address, value):
        if address == CONTROL:
            peer.units[1].registers[CONTROL] = ENABLE

    peer.units[1].on_write = stays_on
    peer.units[1].registers[CONTROL] = ENABLE
    await until(lambda: len(peer.written(CONTROL)) > offs + 6)
    assert set(peer.written(CONTROL)[offs:]) == {OFF}
    assert rig.kinds().count(EventKind.DRIVE_WARNING) == 1
    peer.units[1].on_write = None
    await until(lambda: peer.units[1].registers[CONTROL] == OFF)


async def test_a_new_speed_is_never_sent_with_the_old_direction(peer):
    peer.units[1] = Unit(registers_of("bld-305s"))
    async with running(spec_of(peer, [single("bld-305s")])) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
        await until(lambda: FORWARD in peer.written(RUN))
        mark = len(peer.received)
        rig.loop.velocity_rad_s = {0: -90 * RPM}
        await until(lambda: REVERSE in peer.written(RUN))
        sent = [
            (request.address, *request.values)
            for request in (received.request for received in peer.received[mark:])
            if request.values
        ]
        sent = sent[: sent.index((RUN, REVERSE)) + 1]
        assert sent[-3:] == [(RUN, REST), (SPEED, 90), (RUN, REVERSE)]


@pytest.mark.parametrize("peer", ["asyncio"], indirect=True)  # a pause of Python does not stop rt
async def test_a_drive_that_has_stopped_by_itself_in_a_pause_does_not_start_again(peer):
    """The whole process pauses; then the loop ticks again before the line checks its age."""
    peer.units[1] = Unit(registers_of("duty-register"))
    async with running(spec_of(peer, [single("duty-register")], cycle_hz=10.0)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
        await until(lambda: 50 in peer.written(DUTY))
        mark = len(peer.written(DUTY))
        await until(lambda: len(peer.written(DUTY)) > mark)  # a cycle has just begun
        time.sleep(0.6)  # noqa: ASYNC251  # the pause: of line, loop and drive alike
        rig.loop.put()
        mark = len(peer.written(DUTY))
        await until(lambda: rig.states() == {DriveState.READY})
        await until(lambda: len(peer.written(DUTY)) > mark)
        assert set(peer.written(DUTY)[mark:]) == {0}


@pytest.mark.parametrize("how", ["zero", "power off", "disarm", "the loop has died"])
async def test_a_stop_does_not_wait_for_the_next_cycle_of_a_slow_line(peer, how):
    peer.units[1] = Unit(registers_of("duty-register"))
    spec = spec_of(peer, [single("duty-register")], cycle_hz=1.0, watchdog_s=9.0)
    async with running(spec, in_haste=True) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
        await until(lambda: 50 in peer.written(DUTY))
        if how == "zero":
            rig.loop.duty = {}
        elif how == "disarm":
            await rig.line.disarm()
        elif how == "power off":
            rig.loop.enabled = False
        else:
            rig.loop.running = False
        await until(lambda: peer.written(DUTY)[-1] == 0)
        moving, zero = [
            [
                h.at_s
                for h in peer.received
                if h.request.address == DUTY and h.request.values == (raw,)
            ]
            for raw in (50, 0)
        ]
        assert zero[-1] - moving[-1] < 0.8


@pytest.mark.parametrize("peer", ["asyncio"], indirect=True)  # the rt engine: tests/c/line
async def test_a_new_command_does_not_wait_for_the_next_cycle_of_a_slow_line(peer):
    """The period is changed so that no cycle is due while this test runs."""
    peer.units[1] = Unit(registers_of("duty-register"))
    async with running(spec_of(peer, [single("duty-register")])) as rig:
        await rig.arm()
        rig.line._period_s = 2.0 * GENEROUS_S
        mark = len(peer.written(DUTY))
        for percent in (50, 60, 30):
            await send(rig, percent)
            await until(lambda raw=percent: peer.written(DUTY)[-1] == raw)
            await send(rig, percent)  # the same command again
        await send(rig, 0)
        await until(lambda: peer.written(DUTY)[-1] == 0)
        sent = peer.written(DUTY)[mark:]
        assert len(sent) <= 4 + 1  # one cycle was due by the old period
        assert [raw for raw in dict.fromkeys(sent) if raw] == [50, 60, 30]


@pytest.mark.parametrize("peer", ["asyncio"], indirect=True)  # the rt engine: tests/c
async def test_continuous_commands_do_not_fill_a_slow_line_and_a_stop_is_sent_at_once(peer):
    peer.units[1] = Unit(registers_of("duty-register"))
    async with running(spec_of(peer, [single("duty-register")])) as rig:
        await rig.arm()
        rig.line._period_s = 2.0 * GENEROUS_S
        mark = len(peer.written(DUTY))
        for percent in range(1, 5 * lib.EARLY_AT_ONCE):
            await send(rig, percent)
        await send(rig, 0)
        await until(lambda: peer.written(DUTY)[-1] == 0)
        assert len(peer.written(DUTY)[mark:]) <= lib.EARLY_AT_ONCE + 2  # the stop, and a due cycle


@pytest.mark.parametrize("peer", ["asyncio"], indirect=True)
async def test_a_line_that_nothing_can_wake_is_opened_and_stops_its_drives(peer, monkeypatch):
    def none_left(*_):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(os, "eventfd", none_left)
    monkeypatch.setattr(exchange, "_WAKE_FDS", {})
    peer.units[1] = Unit(registers_of("duty-register"))
    async with running(spec_of(peer, [single("duty-register")])) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
        await until(lambda: 50 in peer.written(DUTY))
        rig.loop.duty = {}
        await until(lambda: peer.written(DUTY)[-1] == 0)
    assert any("is not woken" in event.text for event in rig.events)


async def send(rig, percent):
    """Put a command as the loop does, wake the line, and give it time to handle the command."""
    rig.loop.enabled, rig.loop.duty = True, {0: percent / 100} if percent else {}
    rig.loop.put()
    rig.loop.exchange.wake_line(0)
    for _ in range(20):
        await asyncio.sleep(0)


async def test_a_stop_that_was_lost_on_a_slow_line_is_sent_again_at_once(peer):
    def lose_one_zero(request, honest):
        if (request.address, request.values) == (DUTY, (0,)):
            return []
        peer.tricks.append(lose_one_zero)
        return [(0.0, honest)]

    peer.units[1] = Unit(registers_of("duty-register"))
    spec = spec_of(peer, [single("duty-register")], cycle_hz=1.0, watchdog_s=9.0)
    async with running(spec) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
        await until(lambda: peer.written(DUTY)[-2:] == [50, 50])
        peer.tricks.append(lose_one_zero)
        rig.loop.duty = {}
        await until(lambda: peer.written(DUTY)[-2:] == [0, 0])
        first, second = [h.at_s for h in peer.received if h.request.address == DUTY][-2:]
        assert second - first < 0.8


async def test_shutting_down_also_reports_an_unresponsive_drive(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await set_off(rig, peer)
        peer.units[1].silent = True
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
        mark = len(peer.written(CONTROL))
    assert OFF in peer.written(CONTROL)[mark:]


@pytest.mark.parametrize("peer", ["rt"], indirect=True)  # asyncio arms in one job
@pytest.mark.parametrize("when", ["before it goes", "while it goes"])
async def test_a_drive_that_is_stopped_between_power_and_set_points_is_not_armed(rig, peer, when):
    await rig.ready()
    (drive,) = rig.line._drives
    began = drive.stops
    await drive.enable(began)
    if when == "before it goes":
        off = drive.stand_down()
        with pytest.raises(HalError, match="stopped"):
            await drive.go(began)
    else:
        going = asyncio.create_task(drive.go(began))
        await asyncio.sleep(0)  # `go` runs until it waits
        off = drive.stand_down()
        with pytest.raises(HalError, match="stopped"):
            await going
    await off
    assert rig.states() == {DriveState.READY}
    assert peer.written(CONTROL)[-1] == OFF


@pytest.mark.parametrize("peer", ["rt"], indirect=True)
async def test_an_arming_that_a_stop_interrupts_fails(rig, peer, monkeypatch):
    await rig.ready()
    (drive,) = rig.line._drives
    enable, stops = drive.enable, []

    async def enable_and_stop(began):
        await enable(began)
        asyncio.get_running_loop().call_soon(lambda: stops.append(drive.stand_down()))

    monkeypatch.setattr(drive, "enable", enable_and_stop)
    with pytest.raises(HalError, match="stopped"):
        await rig.line.arm()
    await stops[0]
    assert DriveState.ARMED not in rig.states()


@pytest.mark.parametrize("peer", ["asyncio"], indirect=True)  # C has its own test of this
async def test_a_pending_power_off_outlives_a_new_set_up(rig, peer):
    await rig.ready()
    (drive,) = rig.line._drives
    mark = len(peer.written(CONTROL))
    job = drive.stand_down()
    drive.configure("as after a restart of the drive")
    await until(job.done.done)
    assert job.done.exception() is None
    assert peer.written(CONTROL)[mark:] == [OFF]
    await rig.ready()
