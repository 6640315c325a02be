# SPDX-License-Identifier: Apache-2.0
"""Boards of one's own: the line against the reference board, compiled for this machine."""

import math
import os

import pytest
from frame_board_rig import joints_of, spec_of
from frame_sender import FrameSender
from loop_side import PATIENT_S, running, until
from mcu_peer import McuPeer

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import DriveFault, HalError, NoReply, PortError, ProfileError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    JointSpec,
    LineState,
    Mounting,
)
from motord_hal.mcu.link import Stream
from motord_hal.realtime.exchange import Exchange
from motord_hal.rt_engine.boards import drive as board_drive
from motord_hal.rt_engine.boards import line as board_line
from motord_hal.serial.port import OpenPort, open_port

COUNTS_PER_RAD = 1320 / math.tau


@pytest.fixture
def board_of(program, tmp_path):
    """Function that plugs the board in and returns it."""
    return lambda: McuPeer(program, tmp_path / "board")


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer)) as rig:
        yield rig


async def armed_and_turning(rig, peer, rad_s=3.0):
    await rig.arm()
    rig.loop.velocity_rad_s = {0: rad_s, 1: rad_s}
    await rig.drive(lambda: peer.now.left_mrad_s == round(rad_s * 1000), "it turns")


# ----------------------------------------------------------------------------- set-up and arming
async def test_a_board_is_set_up_with_its_watchdog_and_not_armed(rig, peer):
    await rig.ready()
    assert rig.line.engine == "rt"
    assert rig.line.state is LineState.READY
    assert rig.kinds() == [EventKind.LINE_OPEN, EventKind.DRIVE_READY]
    assert await rig.line.read_register("left", "watchdog") == pytest.approx(0.2)
    assert not any(sent.enabled for sent in peer.sent)


async def test_a_board_that_never_sends_is_reported_unresponsive_once(board_of, monkeypatch):
    monkeypatch.setattr(board_drive, "START_GRACE_S", 0.1)
    peer = board_of()
    peer.do("m")
    async with running(spec_of(peer)) as rig:
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
        cycles = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles > cycles + 20)
        assert rig.kinds() == [EventKind.LINE_OPEN, EventKind.DRIVE_UNRESPONSIVE]
        assert not any(sent.enabled for sent in peer.sent)
    peer.pull()


async def test_only_set_points_of_zero_are_sent_before_arming(rig, peer):
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
    await rig.ready()
    received = rig.line.stats().exchanges
    await until(lambda: rig.line.stats().exchanges > received + 10)
    assert all(sent.left_mrad_s == sent.right_mrad_s == 0 for sent in peer.sent)


async def test_arming_enables_at_zero_and_feedback_reports_so(rig, peer):
    rig.loop.velocity_rad_s = {0: 3.0}  # requested, but the loop has not enabled anything
    await rig.arm()
    await until(lambda: peer.now.enabled, "the peer has sent it, too")
    assert peer.now.left_mrad_s == 0
    await until(lambda: rig.loop.exchange.take_feedback(0).enabled is True)


async def test_it_cannot_be_armed_without_fresh_set_points(rig):
    await rig.ready()
    rig.loop.running = False
    await until(lambda: now_ns() - rig.loop.put_ns > PATIENT_S * 1e9)
    with pytest.raises(HalError, match="no fresh set-points"):
        await rig.line.arm()


async def test_a_board_that_receives_nothing_is_not_armed(rig, peer):
    await rig.ready()
    peer.do("d")
    with pytest.raises(HalError):
        await rig.line.arm()
    assert DriveState.ARMED not in rig.states()
    peer.do("w")
    await rig.arm()


# ------------------------------------------------------------------------------------ set-points
async def test_set_points_are_sent_with_gear_and_direction_and_feedback_comes_back_in_si(rig, peer):
    await armed_and_turning(rig, peer)
    assert peer.now.right_mrad_s == -6000
    right = rig.loop.exchange.take_feedback
    await until(lambda: abs(right(1).velocity_rad_s - 3.0) < 0.01)
    feedback = right(0)
    assert feedback.voltage_v == pytest.approx(24.0)
    assert feedback.temperature_c == pytest.approx(31.0)
    assert feedback.current_a == pytest.approx(0.25)
    assert right(1).current_a == pytest.approx(-0.5)  # it is inverted
    first = feedback
    await until(lambda: right(0).stamp_ns - first.stamp_ns > 0.2e9)
    last = right(0)
    turned_rad = (last.count - first.count) / COUNTS_PER_RAD
    assert turned_rad == pytest.approx((last.stamp_ns - first.stamp_ns) * 3e-9, rel=0.2)
    assert now_ns() - last.stamp_ns < 2e9


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
async def test_a_set_point_that_is_not_finite_is_sent_as_zero(rig, peer, bad):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: bad, 1: 1.0}
    await until(lambda: peer.now.right_mrad_s == -2000)
    assert {sent.left_mrad_s for sent in peer.sent} == {0}


async def test_a_duty_board_is_sent_duties(peer):
    spec = spec_of(peer, joints_of("mcu-duty"))
    async with running(spec) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty, rig.loop.velocity_rad_s = True, {0: 0.5}, {0: 7.0}
        await until(lambda: peer.now.duty == 5000)
        assert {sent.left_mrad_s for sent in peer.sent} == {0}


# -------------------------------------------------------------------------------------- stopping
async def test_set_points_that_were_enabled_only_for_a_moment_take_the_power_off(rig):
    await rig.arm()
    rig.loop.put_for_a_moment()
    await until(lambda: rig.states() == {DriveState.READY})


async def test_set_points_that_are_no_longer_enabled_take_the_power(rig, peer):
    await armed_and_turning(rig, peer)
    rig.loop.enabled = False
    await until(lambda: not peer.now.enabled)
    await until(lambda: rig.states() == {DriveState.READY})
    assert not peer.now.braking


async def test_old_set_points_brake_and_then_take_the_power(rig, peer):
    await armed_and_turning(rig, peer)
    rig.loop.running = False
    await until(lambda: peer.now.braking)
    await until(lambda: not peer.now.braking, "at rest the brake goes off")
    await rig.ready()
    rig.loop.running = True
    received = rig.line.stats().exchanges
    await until(lambda: rig.line.stats().exchanges > received + 10)
    assert not peer.now.enabled, "it does not start again by itself"


async def test_disarming_takes_the_power_and_every_set_point(rig, peer):
    await armed_and_turning(rig, peer)
    await rig.line.disarm()
    assert not peer.now.enabled
    assert peer.now.left_mrad_s == 0


async def test_cancelling_the_line_brakes_and_takes_the_power(board_of):
    peer = board_of()
    async with running(spec_of(peer, watchdog_s=2.0)) as rig:
        await armed_and_turning(rig, peer)
        seen = len(peer.sent)
    await until(lambda: not peer.now.enabled)
    assert any(sent.braking for sent in peer.sent[seen:])
    peer.pull()


async def test_a_board_that_no_longer_receives_stops_by_itself_and_stays_off(rig, peer):
    await armed_and_turning(rig, peer)
    peer.do("d")
    await until(lambda: not peer.now.enabled and peer.now.braking, "its own watchdog")
    await until(lambda: DriveState.ARMED not in rig.states())
    peer.do("w")
    await until(lambda: rig.states() == {DriveState.READY})
    assert not peer.now.enabled


# ---------------------------------------------------------------------- boards that are unplugged
async def test_a_mute_board_is_unresponsive_and_stopped_and_comes_back_disarmed(rig, peer):
    await armed_and_turning(rig, peer)
    peer.do("m")
    await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
    await until(lambda: not peer.now.enabled, "it is stopped though its replies are lost")
    with pytest.raises(NoReply):
        await rig.line.arm()
    peer.do("w")
    await until(lambda: rig.states() == {DriveState.READY})
    assert rig.kinds().count(EventKind.DRIVE_UNRESPONSIVE) == 1
    assert EventKind.DRIVE_BACK in rig.kinds()


async def test_a_restarted_board_is_set_up_again_disarmed_in_a_new_epoch(rig, peer):
    await armed_and_turning(rig, peer)
    epoch = rig.loop.exchange.take_feedback(0).epoch
    peer.do("r")
    await until(lambda: EventKind.DRIVE_WARNING in rig.kinds())
    await until(lambda: rig.states() == {DriveState.READY})
    await until(lambda: rig.loop.exchange.take_feedback(0).epoch > epoch)
    assert not peer.now.enabled


@pytest.mark.parametrize("name", ["mcu-velocity", "mcu-duty"])
async def test_a_board_that_restarts_before_its_first_arming_is_set_up_again(peer, name):
    async with running(spec_of(peer, joints_of(name))) as rig:
        await rig.ready()
        await until(lambda: rig.loop.exchange.take_feedback(0).epoch > 0, "it measures")
        epoch = rig.loop.exchange.take_feedback(0).epoch
        peer.do("r")
        await until(lambda: EventKind.DRIVE_WARNING in rig.kinds())
        await until(lambda: rig.states() == {DriveState.READY})
        await until(lambda: rig.loop.exchange.take_feedback(0).epoch > epoch)


async def test_a_port_that_goes_away_is_reported_once_and_comes_back_disarmed(board_of):
    peer = board_of()
    async with running(spec_of(peer)) as rig:
        await rig.arm()
        peer.pull()
        await until(lambda: rig.line.state is LineState.CLOSED)
        with pytest.raises(PortError):
            await rig.line.arm()
        peer = board_of()
        await until(lambda: rig.states() == {DriveState.READY})
        assert rig.kinds().count(EventKind.LINE_LOST) == 1
        assert rig.line.stats().reopened == 1
        assert not any(sent.enabled for sent in peer.sent)
        peer.pull()


async def test_a_port_that_goes_away_while_it_is_opened_is_opened_again(peer, monkeypatch):
    openings = []

    def pulled_at_first(spec):
        openings.append(spec)
        if len(openings) > 1:
            return open_port(spec)
        master, slave = os.openpty()
        os.close(master)
        return OpenPort(slave, path=spec.port)

    monkeypatch.setattr(board_line, "open_port", pulled_at_first)
    async with running(spec_of(peer)) as rig:
        await rig.ready()
        assert rig.kinds()[:2] == [EventKind.LINE_LOST, EventKind.LINE_OPEN]
        assert "went away" in rig.events[0].text


async def left_turning(peer, spec, spoke=0):
    """Leave the board as a killed program does: enabled and turning, with a watchdog of two
    seconds, after `spoke` earlier frames."""
    sender = FrameSender(spec)
    for _ in range(spoke):
        sender.setpoints({}, now_ns())
    stream = Stream(spec, lambda data: None)
    stream.open()
    for raw in ({"control": 8}, {"control": 1}, {"control": 1, "target_velocity_1": 5000}):
        assert stream.send(sender.setpoints({"watchdog": 2000, **raw}, now_ns()))
    await until(lambda: peer.sent and peer.now.left_mrad_s == 5000, "it turns")
    stream.close()


@pytest.mark.parametrize("spoke", [0, 20_000, 40_000])
async def test_a_board_that_a_dead_program_left_turning_is_braked_and_switched_off(peer, spoke):
    spec = spec_of(peer)
    await left_turning(peer, spec, spoke)
    seen = len(peer.sent)
    assert await halt_line(spec) == []
    assert peer.sent[seen].braking
    assert not peer.sent[-1].enabled
    assert not peer.sent[-1].braking


async def test_a_board_that_a_dead_program_left_turning_follows_a_new_line(peer):
    spec = spec_of(peer)
    await left_turning(peer, spec, spoke=20_000)
    seen = len(peer.sent)
    async with running(spec) as rig:
        await rig.ready()
        assert (peer.sent[seen].enabled, peer.sent[seen].braking) == (False, True)
        assert not peer.now.braking  # released when it rested
        await rig.arm()


async def test_a_board_that_does_not_report_its_status_when_it_is_stopped_is_named(peer):
    peer.do("m")
    problems = await halt_line(spec_of(peer))
    assert problems == ["the board of left, right has not reported its status"]


# ----------------------------------------------------------------------------------------- faults
async def test_a_fault_stops_the_board_is_reported_in_words_and_can_be_cleared(rig, peer):
    await armed_and_turning(rig, peer)
    peer.do("f")
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    await until(lambda: not peer.now.enabled)
    assert rig.line.drive_faults["left"] == ("over-current",)
    await until(lambda: rig.states() == {DriveState.READY})
    assert rig.loop.exchange.take_feedback(0).drive_faults == 1
    with pytest.raises(DriveFault, match="over-current"):
        await rig.line.arm()
    with pytest.raises(DriveFault):
        await rig.line.clear_faults()
    peer.do("g")
    await rig.line.clear_faults()
    assert rig.line.drive_faults["left"] == ()
    assert not peer.now.enabled
    await rig.arm()


# --------------------------------------------------------------- counters, registers, refused lines
async def test_round_trips_and_rates_are_counted(rig):
    await rig.ready()
    await until(lambda: rig.line.stats().exchanges > 30)
    stats = rig.line.stats()
    assert 0 < stats.round_trip.p50_us <= stats.round_trip.max_us
    assert stats.wire_limit_hz > 100
    assert stats.cycle_hz > 0


async def test_registers_are_read_from_feedback_and_those_that_motord_writes_are_refused(rig):
    await rig.ready()
    assert await rig.line.read_register("right", "voltage") == pytest.approx(24.0)
    with pytest.raises(LookupError):
        await rig.line.read_register("left", "control")
    with pytest.raises(LookupError):
        await rig.line.read_register("nobody", "voltage")
    with pytest.raises(ValueError, match="written by motord itself"):
        await rig.line.write_register("left", "watchdog", 1.0)


def test_two_boards_on_one_line_are_refused(peer):
    left, right = joints_of()
    other = JointSpec(index=1, name="right", profile=right.profile, unit=2)
    with pytest.raises(ProfileError, match="one board"):
        open_line(spec_of(peer, (left, other)), Exchange.private(), print)


def test_a_profile_of_another_protocol_is_refused(peer):
    with pytest.raises(ProfileError, match="speaks modbus-rtu"):
        open_line(spec_of(peer, joints_of("zlac8015d")), Exchange.private(), print)


def test_the_thread_in_c_is_the_only_engine(peer):
    with pytest.raises(HalError, match='no engine "asyncio" for mcu'):
        open_line(spec_of(peer, engine="asyncio"), Exchange.private(), print)


async def test_bytes_that_are_no_frame_are_counted_and_change_nothing(rig, peer):
    await rig.ready()
    os.write(peer.master, b"\0\x05hello\0\xff\xff\0")
    await until(lambda: rig.line.stats().errors.get("bad_reply", 0) >= 2)
    assert rig.states() == {DriveState.READY}


# --------------------------------------------------------------------------- a sensor on the board
async def test_a_sensor_on_the_board_reaches_the_core_in_the_bases_axes(peer):
    spec = spec_of(peer, imu=Mounting(up="x", forward="y"))
    async with running(spec) as rig:
        await rig.ready()
        peer.do("i")
        await armed_and_turning(rig, peer)
        # the second motor is inverted and geared, so its shaft turns at -6 rad/s
        turning = -6.0
        await until(lambda: abs(rig.loop.exchange.take_imu().angular_rad_s[2] - turning) < 0.1)
        sample = rig.loop.exchange.take_imu()
        assert sample.acceleration_m_s2[2] == pytest.approx(9.807)
        assert math.isnan(sample.angular_rad_s[1])
        assert 0 < now_ns() - sample.stamp_ns < 5_000_000_000


async def test_a_sensor_that_the_robot_file_does_not_name_is_not_taken(rig, peer):
    await rig.ready()
    peer.do("i")
    exchanges = rig.line.stats().exchanges
    await until(lambda: rig.line.stats().exchanges > exchanges + 20)
    assert rig.loop.exchange.take_imu().stamp_ns == 0
    assert "bad_reply" not in rig.line.stats().errors
