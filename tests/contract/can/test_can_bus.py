# SPDX-License-Identifier: Apache-2.0
"""Faults of a CAN bus itself: bus-off, error frames, a full queue, a flood, no adapter."""

import asyncio
import errno
import socket
import time

import can
import pytest
from can_rig import TURN, bus_that, spec_of
from loop_side import GENEROUS_S, running, until
from scripted_odrive import BUSES, CLOSED_LOOP, ESTIMATES, IDLE, Peer, living

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import PortError
from motord_hal.can.bus import CanBus
from motord_hal.can.motion_gate import MotionGate
from motord_hal.can.plan import Sent
from motord_hal.can.socket_frames import packed
from motord_hal.fieldbus.ports import DriveState, EventKind

BUS_OFF, CONTROLLER, NO_ACK = 0x40, 0x04, 0x20


@pytest.fixture(params=BUSES)
async def peer(request):
    async with living(Peer(request.param, nodes=(0, 3))) as peer:
        yield peer


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer, 0, 3)) as rig:
        yield rig


async def test_bus_off_is_reported_once_and_the_drives_come_back_disarmed(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    peer.send_raw(BUS_OFF, bytes(8), is_error_frame=True)
    await until(lambda: EventKind.LINE_LOST in rig.kinds())
    assert "bus-off" in next(e.text for e in rig.events if e.kind is EventKind.LINE_LOST)
    await until(lambda: rig.kinds().count(EventKind.LINE_OPEN) == 2)
    mark = len(peer.axes[0].velocities())  # what had been sent at the bus-off has come by now
    await rig.ready()
    assert rig.kinds().count(EventKind.LINE_LOST) == 1
    assert rig.kinds().count(EventKind.LINE_OPEN) == 2
    stats = rig.line.stats()
    assert (stats.errors["bus_off"], stats.reopened) == (1, 1)
    await until(lambda: len(peer.axes[0].velocities()) > mark + 3)
    assert set(peer.axes[0].velocities()[mark:]) == {0.0}
    assert peer.axes[0].state == IDLE


async def test_a_drive_that_was_armed_is_stopped_after_a_reopening_even_when_it_is_silent(
    rig, peer
):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    axis = peer.axes[0]
    await until(lambda: any(axis.velocities()))
    axis.silent = True
    peer.send_raw(BUS_OFF, bytes(8), is_error_frame=True)
    await until(lambda: rig.kinds().count(EventKind.LINE_OPEN) == 2)
    await until(lambda: axis.velocities()[-1] == 0.0)
    await until(lambda: axis.state == IDLE)
    assert rig.line.drive_states["wheel0"] in (DriveState.UNKNOWN, DriveState.UNRESPONSIVE)


async def test_error_frames_are_counted_by_kind_and_lose_nothing(rig, peer):
    await rig.arm()
    peer.send_raw(CONTROLLER | NO_ACK, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)), is_error_frame=True)
    await until(lambda: rig.line.stats().errors == {"no_ack": 1, "error_passive": 1})
    assert rig.states() == {DriveState.ARMED}


async def test_a_warning_from_error_frames_is_reported_in_words_and_not_for_each_frame(rig, peer):
    await rig.arm()
    for count in range(1, 4):
        peer.send_raw(CONTROLLER | NO_ACK, bytes((0, 0x30, 0, 0, 0, 0, 0, 0)), is_error_frame=True)
        await until(lambda count=count: rig.line.stats().errors.get("no_ack") == count)
    warnings = [e for e in rig.events if e.kind is EventKind.DRIVE_WARNING]
    assert [
        any(word in e.text for e in warnings) for word in ("error-passive", "acknowledges")
    ] == [
        True,
        True,
    ]
    assert len(warnings) == 2
    assert {e.joints for e in warnings} == {("wheel0", "wheel3")}


async def test_received_frames_cause_no_frames_to_be_sent(rig, peer):
    await rig.arm()
    began, cycles = len(peer.axes[0].velocities()), rig.line.stats().cycles
    frames = rig.line.stats().exchanges
    for hundreds in range(1, 11):
        for _ in range(100):
            peer.say(0, peer.axes[0], ESTIMATES)
        enough = frames + 100 * hundreds
        await until(lambda enough=enough: rig.line.stats().exchanges >= enough)
    # A machine that stands still for long disarms the drives: fewer frames then.
    sent = len(peer.axes[0].velocities()) - began
    assert sent <= rig.line.stats().cycles - cycles + 2  # the first and the last one


async def test_remote_frames_and_long_frames_of_others_are_no_feedback(rig, peer):
    await rig.ready()
    peer.axes[0].no_estimates = True
    peer.send_raw(ESTIMATES, None, is_remote_frame=True, dlc=8)
    peer.send_raw(ESTIMATES, bytes(8), is_fd=False)
    await until(lambda: rig.line.drive_states["wheel0"] is DriveState.UNRESPONSIVE)
    assert rig.line.drive_states["wheel3"] is DriveState.READY


async def test_a_missing_adapter_is_reported_once_with_the_reason(peer):
    async with running(spec_of(peer, 0, port="slcan:/dev/nothing-here")) as rig:
        await until(lambda: rig.events != [])
        assert rig.kinds() == [EventKind.LINE_LOST]
        assert "slcan:/dev/nothing-here" in rig.events[0].text


FRAME = Sent(identifier=1, extended=False, fd=False, data=b"")


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Failed to transmit", errno.ENOBUFS),
        can.CanOperationError("Transmit buffer full"),
        can.CanTimeoutError("too late"),
    ],
)
async def test_a_full_queue_loses_the_frame_and_counts_it(error):
    bus = bus_that(error)
    assert bus.send(FRAME) is False
    assert bus.errors == {"tx_full": 1}
    assert bus.trouble is None
    bus._bus.shutdown()


@pytest.mark.parametrize("number", [errno.ENETDOWN, errno.ENODEV, errno.ENXIO])
async def test_a_bus_that_disappeared_is_a_port_error_with_its_name(number):
    bus = bus_that(can.CanOperationError("Failed to transmit", number))
    with pytest.raises(PortError, match=errno.errorcode[number]):
        bus.send(FRAME)
    with pytest.raises(PortError):
        bus.check()
    bus._bus.shutdown()


@pytest.mark.parametrize("peer", ["virtual"], indirect=True)  # the rt engine: test_can_rt.py
async def test_a_drive_whose_stop_the_bus_did_not_take_is_stopped_with_the_next_cycle(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN, 1: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    real, full = rig.line._bus._bus, bus_that(can.CanTimeoutError("full"))._bus
    rig.line._bus._bus = full
    rig.loop.enabled = False
    await until(lambda: rig.states() == {DriveState.READY})
    assert peer.axes[0].states()[-1] == CLOSED_LOOP
    rig.line._bus._bus = real
    await until(lambda: peer.axes[0].state == peer.axes[3].state == IDLE)
    full.shutdown()


@pytest.mark.parametrize(
    "peer", ["virtual"], indirect=True
)  # the rt engine: tests/c/can_drive/test_can_stops.c
async def test_no_more_motion_is_handed_to_a_bus_that_does_not_send_it(rig, peer):
    await rig.arm()
    rig.line._gate.receives_own = True  # the line waits for its own frames, which never come
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN, 1: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    await until(lambda: peer.axes[0].velocities()[-1] == peer.axes[3].velocities()[-1] == 0.0)
    cycles, mark = rig.line.stats().cycles, len(peer.axes[0].velocities())
    await until(lambda: rig.line.stats().cycles > cycles + 10)
    assert not any(peer.axes[0].velocities()[mark:])
    assert rig.line.stats().errors["tx_full"] > 5
    rig.line._gate.left()
    await until(lambda: any(peer.axes[0].velocities()[mark:]))


@pytest.mark.parametrize("peer", ["virtual"], indirect=True)  # tests/c/can/test_can_kick.c
async def test_motion_that_has_not_left_is_not_followed_by_early_motion(rig, peer):
    """The period is changed so that no cycle is due while this test runs."""
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN, 1: TURN}
    await until(lambda: any(peer.axes[0].velocities()))
    rig.line._period_s = 2.0 * GENEROUS_S
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles)  # one was due by the old period

    async def command(turns):
        rig.loop.velocity_rad_s = {0: turns * TURN, 1: turns * TURN}
        rig.loop.put()
        rig.loop.exchange.wake_line(0)
        for _ in range(20):
            await asyncio.sleep(0)

    await command(1.5)
    await until(lambda: peer.axes[0].velocities()[-1] == 1.5)  # no older frame is in the queue
    rig.line._gate = gate = MotionGate(2.0 * GENEROUS_S, receives_own=True)
    mark = len(peer.axes[0].velocities())
    await command(2.0)
    await until(lambda: peer.axes[0].velocities()[-1] == 2.0)
    await command(3.0)
    gate.left()
    await command(4.0)
    await until(lambda: peer.axes[0].velocities()[-1] == 4.0)
    await command(0.0)
    await until(lambda: peer.axes[0].velocities()[-1] == 0.0)
    assert peer.axes[0].velocities()[mark:] == [2.0, 4.0, 0.0]


@pytest.mark.parametrize("step_s", [0.0, 0.7, 0.95, -0.7, 3600.0])
async def test_setting_the_wall_clock_makes_no_frame_older_than_the_one_before(
    step_s, tmp_path, monkeypatch
):
    came_ns = []
    adapter = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with adapter:
        adapter.bind(str(tmp_path / "bus"))
        adapter.listen()
        address = f"unix:{tmp_path / 'bus'}"
        bus = CanBus(address, 500000, None, [], lambda message, stamp_ns: came_ns.append(stamp_ns))
        await bus.open()
        frame = packed(can.Message(arbitration_id=1, is_extended_id=False, data=b"1"))
        wall_s = time.time
        with adapter.accept()[0] as end:
            first_ns = now_ns()
            end.send(frame)
            await until(lambda: len(came_ns) == 1)
            end.send(frame)
            monkeypatch.setattr(time, "time", lambda: wall_s() + step_s)
            await until(lambda: len(came_ns) == 2)
        bus.close()
    assert first_ns <= came_ns[1] <= now_ns()
