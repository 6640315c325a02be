# SPDX-License-Identifier: Apache-2.0
"""The moteus profile against a register server that follows mjbots' documents."""

import math
import time

import can
import pytest
from can_rig import bus_that
from loop_side import running, until
from scripted_moteus import FAULT, POSITION, STOPPED, TIMEOUT, ZERO_VELOCITY, Moteus
from shared_bus import KINDS, shared_bus

from motord.config.drives.load import find_profile
from motord_hal.can.plan import CanPlan
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec

TURN = 2 * math.pi
NODES = (3, 9)
"""Node numbers: one drive replies with identifiers of 11 bits, the other with 29 bits."""
WATCHDOG_S = 0.25


@pytest.fixture(params=KINDS, ids=" ".join)
def bus(request):
    """Address of a bus, and the engine of the line on it."""
    kind, engine = request.param
    with shared_bus(kind) as address:
        yield address, engine


@pytest.fixture
def address(bus):
    return bus[0]


@pytest.fixture
def drives(address):
    drives = [Moteus(address, node) for node in NODES]
    yield drives
    for drive in drives:
        drive.close()
    assert not any(drive.bad for drive in drives)


@pytest.fixture
def spec(bus):
    address, engine = bus
    joints = tuple(
        JointSpec(index=index, name=f"wheel_{node}", profile=find_profile("moteus"), unit=node)
        for index, node in enumerate(NODES)
    )
    return LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=1_000_000, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine=engine, joints=joints,
        watchdog_s=WATCHDOG_S, data_baudrate=5_000_000,
    )  # fmt: skip


@pytest.fixture
async def rig(drives, spec):
    async with running(spec) as rig:
        yield rig


async def more_cycles(rig):
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 10)


async def turning(rig, drives):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 2 * TURN, 1: -3 * TURN}
    await until(lambda: [drive.values[0x002] for drive in drives] == [2.0, -3.0])


def test_the_server_answers_the_documents_example_as_they_show_it(address):
    """The example is in the maker's docs/protocol/can.md."""
    drive = Moteus(address, 1)
    try:
        drive.values |= {0: POSITION, 1: 0.008, 2: 0.064, 3: -1.44, 0x00D: 12.0, 0x00E: 20.0}
        reply = drive.execute(bytes.fromhex("01000a07206000200150ff140400130d"))
        assert drive.values[0x020] == pytest.approx(0.0096)
        assert drive.values[0x022] == pytest.approx(-1.76)
        assert reply[:5].hex() == "2404000a00"
        assert reply[9:].hex() == "70ff230d181400"
    finally:
        drive.close()


def test_a_command_that_reports_nothing_is_a_stop(address):
    plan = CanPlan([JointSpec(index=0, name="w", profile=find_profile("moteus"), unit=3)])
    drive = Moteus(address, 3)
    try:
        drive.values[0x000] = POSITION
        for raw in ({}, plan.setpoints({})):
            sent = plan.write(plan.table.frames["command"], raw)
            assert (sent.identifier, sent.extended, sent.fd) == (0x8003, True, True)
            drive.execute(sent.data)
            assert drive.mode == STOPPED
        assert math.isnan(drive.values[0x020])
        assert drive.values[0x021] == 0.0
    finally:
        drive.close()


async def test_it_is_set_up_stopped_with_its_watchdog_in_every_command(rig, drives):
    await rig.ready()
    await more_cycles(rig)
    for drive in drives:
        assert set(drive.modes) == {STOPPED}
        assert set(drive.velocities) == {0.0}
        assert drive.values[0x027] == pytest.approx(WATCHDOG_S)


async def test_velocity_and_position_are_sent_and_read_in_si(rig, drives):
    await turning(rig, drives)
    assert all(math.isnan(drive.values[0x020]) for drive in drives)
    drives[0].values |= {0x001: -1.5, 0x004: 4.25}

    def feedback(index):
        return rig.loop.exchange.take_feedback(index)

    await until(lambda: feedback(1).velocity_rad_s == pytest.approx(-3 * TURN))
    await until(lambda: feedback(0).count == (1 << 32) - 12288)
    await until(lambda: feedback(0).current_a == pytest.approx(4.25))
    assert feedback(0).voltage_v == pytest.approx(24.0)
    assert feedback(0).temperature_c == pytest.approx(31.5)
    assert feedback(0).enabled is True


async def test_old_set_points_stop_it_with_zero_velocity_and_then_without_power(rig, drives):
    await turning(rig, drives)
    rig.loop.running = False
    await until(lambda: all(drive.mode == STOPPED for drive in drives))
    for drive in drives:
        last = drive.modes.index(ZERO_VELOCITY)
        assert POSITION not in drive.modes[last:]
        assert [drive.velocities[-1], drive.bites] == [0.0, 0]


@pytest.mark.parametrize("take_power", ["at rest", "disarm", "power off"])
@pytest.mark.parametrize("bus", [one for one in KINDS if one[1] == "asyncio"], indirect=True)
async def test_a_quick_stop_that_waited_is_not_sent_after_the_power_off(rig, drives, take_power):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN * (take_power != "at rest")}
    await until(lambda: drives[0].mode == POSITION)
    await more_cycles(rig)
    drive, bus = rig.line._drives[0], rig.line._bus
    real, full = bus._bus, bus_that(can.CanTimeoutError("full"))._bus
    bus._bus = full
    await drive.quick_stop()
    bus._bus = real
    last = len(drives[0].modes)
    if take_power == "disarm":
        drive.stand_down()
    elif take_power == "power off":
        await drive.power_off()
    await until(lambda: STOPPED in drives[0].modes[last:])
    await more_cycles(rig)
    modes = drives[0].modes[last:]
    assert set(modes[modes.index(STOPPED) :]) == {STOPPED}
    full.shutdown()


async def test_the_watchdog_trips_on_a_silent_master_and_only_a_stop_clears_it(rig, drives):
    await turning(rig, drives)
    drives[0].unreceptive = True
    await until(lambda: drives[0].mode == TIMEOUT)
    drives[0].unreceptive = False
    await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds() or drives[0].mode == STOPPED)
    await until(lambda: rig.line.drive_states["wheel_3"] is DriveState.READY)
    await until(lambda: drives[0].mode == STOPPED)
    await more_cycles(rig)
    assert drives[0].bites == 1
    assert drives[0].mode == STOPPED


async def test_a_pause_of_this_program_makes_no_drive_unresponsive(rig, drives):
    await rig.ready()
    for _ in range(3):
        time.sleep(0.5)  # noqa: ASYNC251  # what a busy machine does to the event loop
        await more_cycles(rig)
    assert EventKind.DRIVE_UNRESPONSIVE not in rig.kinds()
    drives[0].unreceptive = True
    await until(lambda: rig.line.drive_states["wheel_3"] is DriveState.UNRESPONSIVE)


async def test_a_fault_is_reported_and_set_points_do_not_start_it_again(rig, drives):
    await turning(rig, drives)
    drives[1].fail(33)
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    assert "motor driver" in next(
        event.text for event in rig.events if event.kind is EventKind.DRIVE_FAULT
    )
    await until(lambda: drives[1].mode in (FAULT, STOPPED))
    last = len(drives[1].modes)
    await until(lambda: STOPPED in drives[1].modes[last:])
    await until(lambda: rig.line.drive_states["wheel_9"] is DriveState.READY)
    assert drives[1].mode == STOPPED


async def test_a_fault_is_reported_also_where_this_program_had_a_pause_and_the_stop_has_cleared_it(
    rig, drives
):
    await turning(rig, drives)
    drives[1].fail(33)
    time.sleep(0.1)  # noqa: ASYNC251  # the engine in C continues
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    await until(lambda: drives[1].mode == STOPPED)
    await until(lambda: rig.line.drive_faults["wheel_9"] == ())


async def test_a_drive_that_lost_its_power_comes_back_disarmed(rig, drives):
    await turning(rig, drives)
    drives[0].reboot()
    await until(lambda: rig.line.drive_states["wheel_3"] is DriveState.READY)
    assert drives[0].mode == STOPPED
    assert drives[0].velocities[-1] == 0.0


async def test_stop_all_stops_both(drives, spec):
    for drive in drives:
        drive.values |= {0x000: POSITION, 0x002: 2.0}  # as after a crash
    assert await halt_line(spec) == []
    assert [drive.mode for drive in drives] == [STOPPED, STOPPED]


async def test_stop_all_continues_until_a_braking_drive_reports_no_power(drives, spec):
    for drive in drives:
        drive.values |= {0x000: POSITION, 0x002: 2.0}
        drive.lost_stops = 5
    assert await halt_line(spec) == []
    assert [drive.mode for drive in drives] == [STOPPED, STOPPED]
    assert all(ZERO_VELOCITY in drive.modes for drive in drives)


async def test_stop_all_reports_a_drive_that_keeps_its_power_at_rest(drives, spec):
    for drive in drives:
        drive.values |= {0x000: POSITION, 0x002: 2.0}
    drives[0].lost_stops = 1_000_000
    assert await halt_line(spec) == ["wheel_3: reports that it still has power"]
    assert [drive.mode for drive in drives] == [ZERO_VELOCITY, STOPPED]


async def test_a_controller_with_another_register_map_is_refused_before_it_is_commanded(
    spec, drives
):
    for drive in drives:
        drive.values[0x102] = 4
    async with running(spec) as rig:
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "both are refused")
        text = " ".join(event.text for event in rig.events)
        assert "another drive answers, not mjbots moteus" in text
        assert "register_map_version is 4, not 5" in text
        assert drives[0].modes == drives[1].modes == []
