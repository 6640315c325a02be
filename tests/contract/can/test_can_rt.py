# SPDX-License-Identifier: Apache-2.0
"""Guarantee of the CAN line in C: no action and no delay of asyncio moves a motor."""

import math
import time

import pytest
from can_rig import TURN, joints, spec_of
from can_rt_rig import arm, lively
from loop_side import PATIENT_S, running, until
from scripted_odrive import CLOSED_LOOP, IDLE, Peer, living

from motord_hal.base.errors import HalError
from motord_hal.can.socket_frames import unpacked
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, EventKind
from motord_hal.realtime.exchange import Exchange, JointSetpoint, Setpoints


@pytest.fixture
async def rig(bus):
    async with running(spec_of(bus, 0, joints=joints(0))) as rig:
        await until(lambda: EventKind.LINE_OPEN in rig.kinds())
        bus.accept()
        yield rig


async def test_an_event_loop_that_hangs_does_not_keep_a_motor_turning(rig, bus):
    await arm(rig, bus)
    bus.live(PATIENT_S + 0.3)  # the event loop hangs: set-points get old
    assert bus.velocities()[-1] == 0.0
    assert bus.states()[-1] == IDLE
    bus.received.clear()
    await lively(rig, bus, lambda: rig.states() == {DriveState.READY} and bus.velocities())
    assert set(bus.velocities()) == {0.0}


async def test_its_trace_keeps_frames_of_both_directions_while_it_is_on(rig, bus):
    trace = rig.line.trace
    before = trace.newest
    await arm(rig, bus)
    assert trace.newest == before
    trace.switch(on=True)
    await lively(rig, bus, lambda: {one.outward for one in trace.after(before)} == {True, False})
    trace.switch(on=False)
    frames = [unpacked(entry.data, 0.0) for entry in trace.after(before)]
    assert all(len(frame.data) <= 8 and not frame.is_fd for frame in frames)
    numbers = [entry.number for entry in trace.after(before)]
    assert numbers == list(range(before + 1, before + 1 + len(numbers)))


async def test_a_core_that_clears_enabled_while_the_event_loop_hangs_takes_the_power(rig, bus):
    await arm(rig, bus)
    rig.loop.enabled = False
    rig.loop.put()
    bus.live(0.1)
    assert bus.states()[-1] == IDLE
    assert bus.velocities()[-1] == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
async def test_a_set_point_that_is_not_finite_is_zero_on_the_bus(rig, bus, bad):
    await arm(rig, bus)
    rig.loop.velocity_rad_s = {0: bad}
    rig.loop.put()
    bus.received.clear()
    bus.live(0.05)
    assert set(bus.velocities()[1:]) == {0.0}


async def test_a_blocked_bus_loses_set_points_and_then_gets_the_newest(rig, bus):
    await arm(rig, bus)

    def speak_and_not_receive():
        bus.say()
        return rig.line.stats().errors.get("tx_full", 0) > 3

    await until(speak_and_not_receive)
    assert rig.states() <= {DriveState.ARMED, DriveState.READY}
    rig.loop.velocity_rad_s = {0: 3 * TURN}
    rig.loop.put()
    bus.receive()  # the frames that were sent before
    bus.received.clear()
    await lively(rig, bus, lambda: len(bus.velocities()) > 2)
    assert all(one in (0.0, pytest.approx(3.0)) for one in bus.velocities()[1:])


async def test_a_stop_that_the_bus_did_not_take_is_sent_as_soon_as_the_bus_takes_frames(rig, bus):
    await arm(rig, bus)

    def full():
        bus.say()
        return rig.line.stats().errors.get("tx_full", 0) > 3

    await until(full)
    rig.loop.enabled = False

    def disarmed():
        bus.say()
        return rig.states() == {DriveState.READY}

    await until(disarmed)
    assert bus.states()[-1] == CLOSED_LOOP
    bus.received.clear()
    await lively(rig, bus, lambda: bus.state == IDLE)
    assert bus.states()[-1] == IDLE


async def test_a_bus_that_disappears_is_reopened_and_its_drive_is_set_up_disarmed(rig, bus):
    await arm(rig, bus)
    epoch = rig.loop.exchange.take_feedback(0).epoch
    bus.end.close()
    bus.state = IDLE
    bus.received.clear()
    await until(lambda: rig.kinds().count(EventKind.LINE_OPEN) == 2)
    bus.accept()
    await lively(rig, bus, lambda: rig.states() == {DriveState.READY})
    await lively(rig, bus, lambda: rig.loop.exchange.take_feedback(0).epoch > epoch)
    assert rig.kinds().count(EventKind.LINE_LOST) == 1
    assert set(bus.velocities()) <= {0.0}
    assert rig.line.stats().reopened == 1


async def test_feedback_carries_the_time_at_which_the_kernel_received_the_frame(rig, bus):
    await lively(rig, bus, lambda: rig.states() == {DriveState.READY})
    while time.monotonic_ns() < bus.reported_ns + 20_000_000:  # the next sample is a separate one
        bus.receive()
    before_ns = time.monotonic_ns()
    bus.say()
    after_ns = time.monotonic_ns()
    while time.monotonic_ns() < after_ns + 50_000_000:  # the event loop hangs: it looks late
        bus.receive()
    await until(lambda: rig.loop.exchange.take_feedback(0).stamp_ns >= before_ns - 1_000_000)
    assert rig.loop.exchange.take_feedback(0).stamp_ns <= after_ns + 5_000_000


async def test_an_adapter_that_only_python_can_supports_is_refused_by_the_rt_engine(tmp_path):
    async with living(Peer("virtual")) as peer:
        with pytest.raises(HalError, match="SocketCAN"):
            open_line(spec_of(peer, 0, engine="rt"), Exchange.private(), lambda event: None)


async def test_only_zero_is_sent_on_a_line_that_was_not_armed(rig, bus):
    await lively(rig, bus, lambda: rig.states() == {DriveState.READY})
    wheels = tuple(JointSetpoint(TURN, 1.0) for _ in range(8))
    rig.loop.exchange.put_setpoints(
        0, Setpoints(time.monotonic_ns(), 1, enabled=True, joints=wheels)
    )
    bus.live(0.05)
    assert set(bus.velocities()) == {0.0}
