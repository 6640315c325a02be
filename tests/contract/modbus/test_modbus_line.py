# SPDX-License-Identifier: Apache-2.0
"""Modbus lines of both engines and over all media against scripted slaves: which drive is armed,
which is unresponsive, and what is reported."""

import math
from itertools import pairwise

import pytest
from loop_side import running, until
from modbus_rig import (
    CLEAR,
    CONTROL,
    ENABLE,
    ENGINES,
    FAULT_1,
    MODE,
    OFF,
    POSITION_1,
    QUICK_STOP,
    RPM,
    TARGET_1,
    TARGET_2,
    VELOCITY_1,
    VELOCITY_2,
    WATCHDOG,
    hub_servo,
    registers_of,
    single_writes,
    spec_of,
)
from scripted_slave import Unit

from motord.config.drives.load import find_profile
from motord_hal.base.errors import DriveFault, HalError, NoReply, PortError, ProfileError
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    JointSpec,
    LineState,
)
from motord_hal.modbus.codec import Function
from motord_hal.realtime.exchange import Exchange


# ------------------------------------------------------------------------------------ configuring
async def test_a_drive_is_configured_with_its_watchdog_read_back_and_not_armed(rig, peer):
    await rig.ready()
    assert rig.line.state is LineState.READY
    assert peer.written(MODE) == [3]
    assert peer.written(WATCHDOG) == [500]
    asked = [r.address for r in peer.requests() if r.function is Function.READ_HOLDING]
    assert WATCHDOG in asked
    assert ENABLE not in peer.written(CONTROL)
    assert rig.kinds() == [EventKind.LINE_OPEN, EventKind.DRIVE_READY]


async def test_a_watchdog_that_does_not_read_back_keeps_the_drive_from_ready(peer):
    unit = peer.units[1]
    unit.on_write = lambda address, value: unit.registers.update({WATCHDOG: 0})
    async with running(spec_of(peer, hub_servo())) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        assert "communication_timeout" in rig.events[-1].text
        assert rig.states() == {DriveState.UNRESPONSIVE}


async def test_only_set_points_of_zero_are_sent_before_arming(rig, peer):
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
    await rig.ready()
    await until(lambda: len(peer.written(TARGET_1)) > 10)
    assert set(peer.written(TARGET_1)) == set(peer.written(TARGET_2)) == {0}


# ------------------------------------------------------------------------------------ set-points
async def test_both_wheels_are_sent_in_one_request_with_gear_and_direction(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM, 1: 30 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    sent = [r for r in peer.requests() if r.address == TARGET_1 and any(r.values)]
    assert {r.values for r in sent} == {(60, 0x10000 - 60)}
    assert {r.function for r in sent} == {Function.WRITE_MULTIPLE}


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
async def test_a_set_point_that_is_not_finite_is_sent_as_zero(rig, peer, bad):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: bad, 1: 30 * RPM}
    await until(lambda: 0x10000 - 60 in peer.written(TARGET_2))
    assert set(peer.written(TARGET_1)) == {0}


async def test_a_set_point_beyond_the_drive_s_range_is_sent_as_its_limit(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 1e9}
    await until(lambda: 3000 in peer.written(TARGET_1))
    assert set(peer.written(TARGET_1)) == {0, 3000}


# -------------------------------------------------------------------------------------- feedback
async def test_feedback_comes_in_si_at_the_wheel_with_a_raw_count(rig, peer):
    words = peer.units[1].registers
    words.update({POSITION_1: 0xFFFF, POSITION_1 + 1: 0xFFFE, VELOCITY_1: 300, VELOCITY_2: 300})
    words.update({0x20A1: 2412, 0x20A4: 0x1EF0, 0x20AD: 0x10000 - 15})
    await rig.ready()
    left, right = (lambda: rig.loop.exchange.take_feedback(0)), rig.loop.exchange.take_feedback
    await until(lambda: left().stamp_ns > 0 and left().enabled is False)
    assert left().count == 0xFFFFFFFE
    assert left().velocity_rad_s == pytest.approx(30 * RPM)
    assert left().voltage_v == pytest.approx(24.12)
    assert left().temperature_c == 30
    assert left().current_a == pytest.approx(-1.5)
    assert left().epoch > 0
    assert right(1).velocity_rad_s == pytest.approx(-15 * RPM)
    assert right(1).temperature_c == -16


async def test_feedback_reports_enabled_once_armed(rig):
    await rig.arm()
    await until(lambda: rig.loop.exchange.take_feedback(0).enabled is True)


# --------------------------------------------------------------------------------------- stopping
async def test_set_points_that_were_enabled_only_for_a_moment_take_the_power_off(rig):
    await rig.arm()
    rig.loop.put_for_a_moment()
    await until(lambda: rig.states() == {DriveState.READY})


async def test_set_points_that_are_no_longer_enabled_take_the_power_off(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    rig.loop.enabled = False
    await until(lambda: peer.written(CONTROL)[-1] == OFF)
    await until(lambda: rig.states() == {DriveState.READY})
    count = len(peer.written(TARGET_1))
    await until(lambda: len(peer.written(TARGET_1)) > count)
    assert peer.written(TARGET_1)[-1] == 0


async def test_old_set_points_stop_the_drive_quickly_and_then_take_its_power(rig, peer):
    peer.units[1].registers[VELOCITY_1] = 600
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    rig.loop.running = False
    await until(lambda: peer.written(CONTROL)[-1] == QUICK_STOP)
    await until(lambda: rig.states() == {DriveState.READY})
    peer.units[1].registers[VELOCITY_1] = 0
    await until(lambda: peer.written(CONTROL)[-1] == OFF)
    assert peer.written(TARGET_1)[-1] == 0
    rig.loop.running = True  # the loop is back: nothing moves by itself
    count = len(peer.written(TARGET_1))
    await until(lambda: len(peer.written(TARGET_1)) > count + 5)
    assert set(peer.written(TARGET_1)[count:]) == {0}


async def test_a_stop_that_was_not_answered_is_sent_again(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))

    def lose_the_power_off(request, honest):
        if request.address != CONTROL or not request.values:
            peer.tricks.append(lose_the_power_off)
            return [(0.0, honest)]
        return []

    peer.tricks.append(lose_the_power_off)
    rig.loop.enabled = False
    await until(lambda: peer.written(CONTROL)[-2:] == [OFF, OFF])


async def test_cancelling_the_line_stops_and_disarms_every_drive(peer):
    spec = spec_of(peer, (*hub_servo(1), *hub_servo(2, first=2)))
    # in haste: the end has 0.5 s, and the interrupted exchange costs a reply time-out of it
    async with running(spec, in_haste=True) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM, 2: 60 * RPM}
        await until(lambda: 60 in peer.written(TARGET_1, unit=2))
    assert rig.task.cancelled()
    for unit in (1, 2):
        sent = peer.written(CONTROL, unit)
        assert set(sent[sent.index(QUICK_STOP) + 1 :]) == {OFF}
        assert peer.written(TARGET_1, unit)[-1] == 0
    assert rig.line.state is LineState.CLOSED


# -------------------------------------------------------------------------------------- disarming
async def test_disarming_sends_zero_and_the_power_off(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    await rig.line.disarm()
    assert peer.written(CONTROL)[-1] == OFF
    assert rig.states() == {DriveState.READY}
    await until(lambda: peer.written(TARGET_1)[-1] == 0)


async def test_a_closed_line_reports_so(peer, tmp_path):
    spec = spec_of(peer, hub_servo(), port=str(tmp_path / "nothing"))
    async with running(spec) as rig:
        for order in (rig.line.arm, rig.line.disarm, rig.line.clear_faults):
            with pytest.raises(PortError):
                await order()


# ----------------------------------------------------------------------------------- unresponsive
async def test_an_unresponsive_drive_is_reported_once_and_comes_back_configured_and_disarmed(
    rig, peer
):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    peer.units[1].silent = True
    await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
    asked = len(peer.requests())
    await until(lambda: len(peer.requests()) >= asked + 4, "it is probed")
    epoch = rig.loop.exchange.take_feedback(0).epoch
    peer.units[1].registers.update({CONTROL: 0, MODE: 0, WATCHDOG: 0})  # it had lost its power
    peer.units[1].silent = False
    mark = len(peer.received)
    await rig.ready()
    await until(lambda: rig.loop.exchange.take_feedback(0).epoch > epoch)
    back = [h.request for h in peer.received[mark:]]
    assert all(not any(r.values) for r in back if r.address == TARGET_1)
    assert peer.units[1].registers[WATCHDOG] == 500
    assert rig.kinds()[2:] == [EventKind.DRIVE_UNRESPONSIVE, EventKind.DRIVE_BACK]


async def test_a_drive_that_answers_again_brakes_and_is_switched_off_before_it_is_set_up(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    peer.units[1].silent = True
    await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
    mark = len(peer.received)
    peer.units[1].silent = False
    await rig.ready()
    written = single_writes(peer, mark)
    off = written.index((CONTROL, OFF))
    assert set(written[:off]) <= {(CONTROL, QUICK_STOP)}, "its probes may brake it"


async def test_a_dead_drive_costs_its_neighbour_one_slot_at_a_time(peer):
    peer.units[2].silent = True
    async with running(spec_of(peer, (*hub_servo(1), *hub_servo(2, first=2)))) as rig:
        await until(lambda: rig.line.drive_states["left2"] is DriveState.UNRESPONSIVE)
        await until(lambda: rig.line.drive_states["left1"] is DriveState.READY)
        mark = len(peer.received)
        await until(lambda: sum(h.request.unit == 2 for h in peer.received[mark:]) >= 4)
        units = [h.request.unit for h in peer.received[mark:]]
        assert all(not (a == b == 2) for a, b in pairwise(units))
        with pytest.raises(NoReply, match="left2"):
            await rig.line.arm()


async def test_a_drive_that_loses_single_replies_stays_ready(rig, peer):
    await rig.ready()
    for _ in range(2):
        peer.tricks.append(lambda request, honest: [])
    await until(lambda: rig.line.stats().errors.get("no_reply") == 2)
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 5)
    assert EventKind.DRIVE_UNRESPONSIVE not in rig.kinds()


@pytest.mark.parametrize("peer", ENGINES, indirect=True)
async def test_an_unresponsive_drive_whose_bytes_are_no_frames_hints_at_the_baud_rate(rig, peer):
    await rig.ready()
    peer.tricks.extend(3 * [lambda request, honest: [(0.0, b"\xfe\x00\xf8\x80")]])
    await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
    shown = next(event.text for event in rig.events if event.kind is EventKind.DRIVE_UNRESPONSIVE)
    assert "baud rate or parity?" in shown


async def test_a_drive_that_refuses_its_configuration_is_reported_once(peer):
    peer.units[1].refuses.add(MODE)
    async with running(spec_of(peer, hub_servo())) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        refused = rig.line.stats().errors["refused"]
        await until(lambda: rig.line.stats().errors["refused"] >= refused + 2)
        assert rig.kinds().count(EventKind.DRIVE_UNRESPONSIVE) == 1
        assert "illegal data address" in rig.events[-1].text


async def test_a_drive_that_reports_it_is_not_enabled_is_set_up_again_disarmed(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    epoch, mark = rig.loop.exchange.take_feedback(0).epoch, len(peer.received)
    peer.units[1].registers[CONTROL] = 0
    await until(lambda: rig.kinds()[2:] == [EventKind.DRIVE_WARNING, EventKind.DRIVE_READY])
    assert rig.states() == {DriveState.READY}
    after = [h.request for h in peer.received[mark:]]
    configured = next(n for n, r in enumerate(after) if r.address == MODE and r.values)
    assert all(not any(r.values) for r in after[configured:] if r.address == TARGET_1)
    await until(lambda: rig.loop.exchange.take_feedback(0).epoch > epoch)


async def test_an_armed_drive_that_lost_its_set_up_loses_its_power_before_it_is_set_up_again(
    rig, peer
):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: 60 in peer.written(TARGET_1))
    mark = len(peer.received)
    peer.units[1].registers[WATCHDOG] = 0
    await until(lambda: rig.kinds()[2:] == [EventKind.DRIVE_WARNING, EventKind.DRIVE_READY])
    # the cycle writes both wheels in one request, which `single_writes` leaves out
    assert single_writes(peer, mark)[0] == (CONTROL, OFF)


# ----------------------------------------------------------------------------------------- faults
async def test_faults_are_reported_once_in_words_and_once_when_gone(rig, peer):
    await rig.ready()
    peer.units[1].registers[FAULT_1] = 0b101
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    await until(lambda: rig.loop.exchange.take_feedback(0).drive_faults == 0b101)
    assert rig.line.drive_faults == {"left1": ("over-voltage", "over-current"), "right1": ()}
    assert rig.events[-1].joints == ("left1",)
    with pytest.raises(DriveFault, match="over-current"):
        await rig.line.arm()
    peer.units[1].registers[FAULT_1] = 0
    await until(lambda: EventKind.DRIVE_FAULT_GONE in rig.kinds())
    assert rig.kinds().count(EventKind.DRIVE_FAULT) == 1


async def test_faults_are_cleared_by_the_profile_s_steps(rig, peer):
    def obey(address, value):
        if (address, value) == (CONTROL, CLEAR):
            peer.units[1].registers[FAULT_1] = 0

    await rig.ready()
    peer.units[1].registers[FAULT_1] = 4
    await until(lambda: rig.line.drive_faults["left1"] != ())
    with pytest.raises(DriveFault):
        await rig.line.clear_faults()
    peer.units[1].on_write = obey
    await rig.line.clear_faults()
    await until(lambda: rig.line.drive_faults["left1"] == ())


# ------------------------------------------------------------------------------------ other drives
async def test_a_duty_is_sent_in_per_cent_and_never_negative(peer):
    peer.units[1] = Unit(registers_of("duty-register"))
    profile = find_profile("duty-register")
    joints = (JointSpec(index=0, name="fan", profile=profile, unit=1),)
    async with running(spec_of(peer, joints)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.375}
        await until(lambda: 38 in peer.written(0x0100))
        rig.loop.duty = {0: -0.5}
        await until(lambda: peer.written(0x0100)[-1] == 0)
        assert set(peer.written(0x0100)) == {0, 38}
        assert rig.loop.exchange.take_feedback(0).enabled is None


async def test_a_magnitude_is_sent_with_its_direction(peer):
    speed, run = 0x0056, 0x0066
    peer.units[1] = Unit(registers_of("bld-305s"))
    joints = (JointSpec(index=0, name="mill", profile=find_profile("bld-305s"), unit=1),)
    async with running(spec_of(peer, joints)) as rig:
        await rig.arm()
        assert set(peer.written(run)) == {0}
        peer.units[1].registers[0x005F] = 90
        for sign, direction in ((1, 1), (-1, 2)):
            rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: sign * 90 * RPM}
            await until(lambda direction=direction: peer.written(run)[-1] == direction)
            await until(lambda: peer.written(speed)[-1] == 90)
            want = pytest.approx(sign * 90 * RPM)
            await until(lambda want=want: rig.loop.exchange.take_feedback(0).velocity_rad_s == want)
        rig.loop.velocity_rad_s = {}
        await until(lambda: peer.written(run)[-1] == 0 and peer.written(speed)[-1] == 0)
        rig.loop.velocity_rad_s = {0: 90 * RPM}
        await until(lambda: peer.written(run)[-1] == 1)
        rig.loop.running = False
        await until(lambda: 3 in peer.written(run), "it brakes")


async def test_a_fault_code_is_a_single_fault_listed_or_not(peer):
    peer.units[1] = Unit(registers_of("bld-305s"))
    joints = (JointSpec(index=0, name="mill", profile=find_profile("bld-305s"), unit=1),)
    async with running(spec_of(peer, joints)) as rig:
        await rig.ready()
        for code, words in ((3, "over-voltage"), (77, "unlisted fault code 77")):
            peer.units[1].registers[0x0076] = code
            await until(lambda words=words: rig.line.drive_faults["mill"] == (words,))
            await until(lambda code=code: rig.loop.exchange.take_feedback(0).drive_faults == code)


# --------------------------------------------------------------------------------------- counters
async def test_the_counters_are_kept(rig, peer):
    await rig.ready()
    await until(lambda: rig.line.stats().cycles > 20)
    received = len(peer.received)  # both continue meanwhile
    await until(lambda: rig.line.stats().exchanges >= received)
    stats = rig.line.stats()
    assert stats.cycle_hz > 0
    assert 0 < stats.round_trip.p50_us <= stats.round_trip.p99_us <= stats.round_trip.max_us


async def test_the_wire_limit_is_arithmetic(rig):
    bit_s, gap_s = 10 / 115200, 1.75e-3
    write, read, extra = (13 + 8, 8 + 33, (8 + 7 + 8 + 9) / 2)  # watchdog; mode and command
    want_s = bit_s * (write + read + extra / 4) + 2 * gap_s * (2 + 1 / 4)
    assert rig.line.stats().wire_limit_hz == pytest.approx(1 / want_s)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"kind": "modbus-rtx"}, 'no line kind "modbus-rtx"'),
        ({"joints": (*hub_servo(1), *hub_servo(1))}, "both channel 1 of unit 1"),
    ],
)
async def test_an_impossible_line_is_refused_before_it_runs(peer, changes, problem):
    with pytest.raises((HalError, ProfileError), match=problem):
        open_line(spec_of(peer, **{"joints": hub_servo(), **changes}), Exchange.private(), print)
