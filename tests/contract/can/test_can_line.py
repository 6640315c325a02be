# SPDX-License-Identifier: Apache-2.0
"""CAN lines against scripted drives that send raw frames: which drive is armed, which is
unresponsive, and what is reported."""

import asyncio
import math
import struct

import pytest
from can_rig import TURN, spec_of
from loop_side import PATIENT_S, running, until
from scripted_odrive import (
    BUSES,
    CLEAR,
    CLOSED_LOOP,
    ESTIMATES,
    IDLE,
    INPUT_VELOCITY,
    MODE,
    STATE,
    Peer,
    living,
)

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import DriveFault, HalError, NoReply, PortError
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    LineState,
)


@pytest.fixture(params=BUSES)
async def peer(request):
    async with living(Peer(request.param, nodes=(0, 3))) as peer:
        yield peer


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer, 0, 3)) as rig:
        yield rig


# ------------------------------------------------------------------------------------ configuring
async def test_a_drive_is_configured_and_not_armed(rig, peer):
    await rig.ready()
    assert rig.line.state is LineState.READY
    assert rig.line.engine == BUSES[peer.kind]
    await until(lambda: peer.axes[0].mode == peer.axes[3].mode == (2, 1))
    assert CLOSED_LOOP not in peer.axes[0].states()
    assert rig.kinds() == [EventKind.LINE_OPEN, EventKind.DRIVE_READY, EventKind.DRIVE_READY]


async def test_signals_of_one_frame_are_written_together(rig, peer):
    await rig.ready()
    await until(lambda: peer.axes[0].sent(MODE) != [])
    assert peer.axes[0].sent(MODE) == [struct.pack("<II", 2, 1)]


async def test_only_set_points_of_zero_are_sent_before_arming(rig, peer):
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
    await rig.ready()
    await until(lambda: len(peer.axes[0].velocities()) > 10)
    assert set(peer.axes[0].velocities()) == set(peer.axes[3].velocities()) == {0.0}


async def test_a_drive_that_was_left_running_is_stopped_when_the_line_opens(peer):
    peer.axes[0].state = CLOSED_LOOP
    async with running(spec_of(peer, 0)) as rig:
        await rig.ready()
        assert peer.axes[0].states()[0] == IDLE


async def test_a_drive_that_turns_when_the_line_opens_is_braked_before_it_is_idle(peer):
    axis = peer.axes[0]
    axis.state, axis.velocity_turns_s = CLOSED_LOOP, 2.0
    async with running(spec_of(peer, 0)) as rig:
        await until(lambda: len(axis.velocities()) > 2, "it is braked, more than once")
        assert (set(axis.velocities()), axis.states()) == ({0.0}, [])
        axis.velocity_turns_s = 0.0
        await rig.ready()
        assert axis.states()[0] == IDLE
        assert "turned when it was set up" in rig.events[1].text


async def test_a_drive_whose_set_up_fails_is_reported_once_and_tried_seldom(peer):
    peer.axes[0].state, peer.axes[0].stuck = CLOSED_LOOP, True
    async with running(spec_of(peer, 0)) as rig:
        await until(lambda: len(peer.axes[0].states()) >= 3)
        assert rig.kinds().count(EventKind.DRIVE_UNRESPONSIVE) == 1
        assert "axis_state" in rig.events[-1].text
        assert EventKind.DRIVE_READY not in rig.kinds()


# ------------------------------------------------------------------------------------ set-points
async def test_set_points_are_sent_in_turns_with_gear_and_direction(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN, 1: TURN}
    await until(lambda: any(peer.axes[0].velocities()) and any(peer.axes[3].velocities()))
    assert peer.axes[0].velocities()[-1] == pytest.approx(1.0)
    assert peer.axes[3].velocities()[-1] == pytest.approx(-2.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
async def test_a_set_point_that_is_not_finite_is_sent_as_zero(rig, peer, bad):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: bad, 1: TURN}
    await until(lambda: any(peer.axes[3].velocities()))
    assert set(peer.axes[0].velocities()) == {0.0}


async def test_a_set_point_beyond_the_drive_s_range_is_sent_as_its_limit(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 1e30}
    await until(lambda: any(peer.axes[0].velocities()))
    assert set(peer.axes[0].velocities()) == {0.0, 200.0}


# -------------------------------------------------------------------------------------- feedback
async def test_feedback_comes_in_si_at_the_wheel_with_a_count(rig, peer):
    for axis in peer.axes.values():
        axis.position_turns, axis.velocity_turns_s = -0.25, 2.0
        axis.voltage_v, axis.current_a = 23.5, -1.5
    await rig.ready()

    def left():
        return rig.loop.exchange.take_feedback(0)

    await until(lambda: left().voltage_v > 0 and left().current_a < 0)
    await until(lambda: rig.loop.exchange.take_feedback(1).stamp_ns > 0)
    assert left().count == (1 << 32) - 2048
    assert left().velocity_rad_s == pytest.approx(2 * TURN)
    assert left().voltage_v == pytest.approx(23.5)
    assert left().current_a == pytest.approx(-1.5)
    assert left().enabled is False
    assert left().epoch == 1
    assert 0 < now_ns() - left().stamp_ns < 20e9
    assert rig.loop.exchange.take_feedback(1).velocity_rad_s == pytest.approx(-TURN)


async def test_feedback_reports_enabled_once_armed(rig):
    await rig.arm()
    await until(lambda: rig.loop.exchange.take_feedback(0).enabled is True)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
async def test_a_position_that_is_not_finite_is_no_feedback(rig, peer, bad):
    await rig.ready()
    peer.axes[0].position_turns = bad
    frames = rig.line.stats().exchanges
    await until(lambda: rig.line.stats().exchanges > frames + 20)
    stamp_ns = rig.loop.exchange.take_feedback(0).stamp_ns
    frames = rig.line.stats().exchanges
    await until(lambda: rig.line.stats().exchanges > frames + 20)
    assert rig.loop.exchange.take_feedback(0).stamp_ns == stamp_ns


async def test_a_frame_that_was_cut_short_is_counted_and_ignored(rig, peer):
    await rig.ready()
    peer.axes[0].no_estimates = True
    peer.send(0, ESTIMATES, struct.pack("<f", 100.0))
    await until(lambda: rig.line.stats().errors.get("bad_frame") == 1)
    assert rig.loop.exchange.take_feedback(0).count == 0


async def test_frames_of_nodes_that_are_not_the_robot_s_change_nothing(rig, peer):
    await rig.ready()
    for command in range(32):
        peer.send(17, command, bytes([0xFF] * 8))
    frames = rig.line.stats().exchanges
    await until(lambda: rig.line.stats().exchanges > frames + 20)
    assert rig.states() == {DriveState.READY}
    assert rig.line.stats().errors == {}


# --------------------------------------------------------------------------------------- stopping
async def test_set_points_that_were_enabled_only_for_a_moment_take_the_power_off(rig):
    await rig.arm()
    rig.loop.put_for_a_moment()
    await until(lambda: rig.states() == {DriveState.READY})


async def test_set_points_that_are_no_longer_enabled_take_the_power_off(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    rig.loop.enabled = False
    await until(lambda: peer.axes[0].states()[-1] == IDLE)
    await until(lambda: rig.states() == {DriveState.READY})
    count = len(peer.axes[0].velocities())
    await until(lambda: len(peer.axes[0].velocities()) > count + 3)
    assert set(peer.axes[0].velocities()[count:]) == {0.0}


async def test_old_set_points_stop_the_drive_and_take_its_power_when_it_is_at_rest(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    peer.axes[0].velocity_turns_s = 1.0
    sent = len(peer.axes[0].states())
    rig.loop.running = False
    await until(lambda: rig.states() == {DriveState.READY})
    await until(lambda: peer.axes[0].velocities()[-1] == 0.0)
    peer.axes[0].velocity_turns_s = 0.0
    await until(lambda: peer.axes[0].states()[sent:] == [IDLE])
    rig.loop.running = True  # the loop is back: nothing moves by itself
    count = len(peer.axes[0].velocities())
    await until(lambda: len(peer.axes[0].velocities()) > count + 5)
    assert set(peer.axes[0].velocities()[count:]) == {0.0}


async def test_a_power_off_that_was_lost_is_sent_again(rig, peer):
    await rig.arm()
    peer.axes[0].ignored.add(STATE)
    rig.loop.enabled = True
    await until(lambda: rig.loop.exchange.take_feedback(0).enabled is True)
    await rig.line.disarm()
    sent = peer.axes[0].states().count(IDLE)
    await until(lambda: peer.axes[0].states().count(IDLE) > sent + 1)
    await until(lambda: EventKind.DRIVE_WARNING in rig.kinds())
    assert "stays enabled" in rig.events[-1].text
    peer.axes[0].ignored.clear()
    await until(lambda: peer.axes[0].state == IDLE)


async def test_cancelling_the_line_stops_and_disarms_every_drive(peer):
    async with running(spec_of(peer, 0, 3)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN, 1: TURN}
        await until(lambda: any(peer.axes[3].velocities()))
    assert rig.task.cancelled()
    for axis in peer.axes.values():
        await until(lambda axis=axis: axis.state == IDLE)
        assert axis.velocities()[-1] == 0.0
        assert axis.states()[-1] == IDLE
    assert rig.line.state is LineState.CLOSED


# ----------------------------------------------------------------------------------------- arming
async def test_arming_fails_when_a_drive_does_not_report_it_is_enabled(rig, peer):
    await rig.ready()
    peer.axes[3].ignored.add(STATE)
    with pytest.raises(DriveFault, match="axis_state"):
        await rig.line.arm()
    await until(lambda: peer.axes[0].state == IDLE and peer.axes[0].states()[-1] == IDLE)
    assert DriveState.ARMED not in rig.states()


async def test_a_cancelled_arming_leaves_nothing_armed(rig, peer):
    await rig.ready()
    peer.axes[3].ignored.add(STATE)
    task = asyncio.ensure_future(rig.line.arm())
    await until(lambda: CLOSED_LOOP in peer.axes[0].states())
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await until(lambda: peer.axes[0].states()[-1] == IDLE)
    await rig.ready()


async def test_arming_without_fresh_set_points_is_refused(rig, peer):
    await rig.ready()
    rig.loop.running = False
    await until(lambda: now_ns() - rig.loop.put_ns > PATIENT_S * 1e9)
    with pytest.raises(HalError, match="no fresh set-points"):
        await rig.line.arm()
    assert DriveState.ARMED not in rig.states()


async def test_a_drive_is_sent_zero_before_it_is_armed(rig, peer):
    await rig.arm()
    received = peer.axes[0].received
    armed = next(n for n, (c, d) in enumerate(received) if (c, d[:1]) == (STATE, b"\x08"))
    before = [d for c, d in received[:armed] if c == INPUT_VELOCITY]
    assert before[-1] == bytes(8)
    assert set(before) == {bytes(8)}


async def test_disarming_sends_zero_and_the_power_off(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    await rig.line.disarm()
    assert rig.states() == {DriveState.READY}
    await until(lambda: peer.axes[0].state == IDLE)
    await until(lambda: peer.axes[0].velocities()[-1] == 0.0)


async def test_a_closed_line_reports_so(peer):
    async with running(spec_of(peer, 0, port="socketcan:nothing0")) as rig:
        await until(lambda: EventKind.LINE_LOST in rig.kinds())
        for order in (rig.line.arm, rig.line.disarm, rig.line.clear_faults):
            with pytest.raises(PortError):
                await order()
        assert rig.kinds() == [EventKind.LINE_LOST]
        assert "there is no CAN interface" in rig.events[0].text


# ----------------------------------------------------------------------------------- unresponsive
async def test_a_drive_that_never_sends_is_reported_once(peer):
    peer.axes[0].silent = True
    async with running(spec_of(peer, 0, 3)) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        await until(lambda: rig.line.drive_states["wheel3"] is DriveState.READY)
        cycles = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles > cycles + 50)
        assert rig.kinds().count(EventKind.DRIVE_UNRESPONSIVE) == 1
        with pytest.raises(NoReply, match="wheel0"):
            await rig.line.arm()


@pytest.mark.parametrize("what", ["silent", "no_estimates", "no_heartbeat"])
async def test_a_drive_that_falls_silent_comes_back_configured_and_disarmed(rig, peer, what):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    setattr(peer.axes[0], what, True)
    await until(lambda: rig.line.drive_states["wheel0"] is DriveState.UNRESPONSIVE)
    epoch = rig.loop.exchange.take_feedback(0).epoch
    await until(lambda: peer.axes[0].states()[-1] == IDLE, "one that may turn is sent a stop")
    mark = len(peer.axes[0].velocities())
    peer.axes[0].state, peer.axes[0].mode = IDLE, (3, 1)  # it had lost its power
    setattr(peer.axes[0], what, False)
    await until(lambda: rig.line.drive_states["wheel0"] is DriveState.READY)
    await until(lambda: rig.loop.exchange.take_feedback(0).epoch > epoch)
    await until(lambda: peer.axes[0].mode == (2, 1))
    await until(lambda: len(peer.axes[0].velocities()) > mark + 3)
    assert set(peer.axes[0].velocities()[mark:]) == {0.0}
    assert rig.kinds()[3:] == [EventKind.DRIVE_UNRESPONSIVE, EventKind.DRIVE_BACK]


async def test_sends_that_succeed_do_not_make_a_drive_present(rig, peer):
    await rig.arm()
    peer.axes[0].silent = True
    await until(lambda: rig.line.drive_states["wheel0"] is DriveState.UNRESPONSIVE)
    assert rig.line.stats().errors == {}


async def test_a_drive_that_reports_it_is_not_enabled_is_set_up_again_disarmed(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    peer.axes[0].state = IDLE
    await until(lambda: rig.kinds()[3:] == [EventKind.DRIVE_WARNING, EventKind.DRIVE_READY])
    assert rig.line.drive_states["wheel0"] is DriveState.READY
    mark = len(peer.axes[0].velocities())
    await until(lambda: len(peer.axes[0].velocities()) > mark + 5)
    assert set(peer.axes[0].velocities()[mark:]) == {0.0}


# ----------------------------------------------------------------------------------------- faults
async def test_faults_are_reported_once_in_words_and_once_when_gone(rig, peer):
    await rig.ready()
    peer.axes[0].error = 0x4000 | 0x40
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    await until(lambda: rig.loop.exchange.take_feedback(0).drive_faults == 0x4040)
    assert rig.line.drive_faults["wheel0"] == ("motor failed", "emergency stop requested")
    with pytest.raises(DriveFault, match="motor failed"):
        await rig.line.arm()
    await rig.line.clear_faults()
    assert peer.axes[0].sent(CLEAR)
    assert not peer.axes[3].sent(CLEAR)
    await until(lambda: EventKind.DRIVE_FAULT_GONE in rig.kinds())


async def test_clearing_faults_that_stay_is_an_error(rig, peer):
    await rig.ready()
    peer.axes[0].error = 0x40
    peer.axes[0].ignored.add(CLEAR)
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    with pytest.raises(DriveFault, match="axis_error"):
        await rig.line.clear_faults()


# -------------------------------------------------------------------------------------- registers
async def test_a_signal_is_read_on_request_or_from_the_next_frame(rig, peer):
    await rig.ready()
    peer.axes[3].voltage_v = 22.25
    assert await rig.line.read_register("wheel3", "bus_voltage") == pytest.approx(22.25)
    assert await rig.line.read_register("wheel3", "axis_state") == IDLE
    with pytest.raises(LookupError):
        await rig.line.read_register("wheel3", "input_velocity")
    with pytest.raises(LookupError):
        await rig.line.write_register("wheel3", "requested_state", 8.0)
