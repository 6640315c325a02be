# SPDX-License-Identifier: Apache-2.0
"""ODrives in position control, against axes that send raw frames and go to their input at once."""

import asyncio
import math
import struct

import pytest
from loop_side import running, until
from scripted_odrive import (
    CLOSED_LOOP,
    IDLE,
    INPUT_POSITION,
    INPUT_VELOCITY,
    INTERFACE,
    MODE,
    POSITION_CONTROL,
    STATE,
    VELOCITY_CONTROL,
    Peer,
    living,
)
from tests.shipped import shipped_profile

from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import DriveState, JointSpec, LineSpec

NODE = 4
HERE_TURNS = 0.375
"""Position of the axis; its position input is 0 when it is switched on."""
ZERO_COUNT = 4096
PASS_THROUGH = 1


@pytest.fixture
async def peer():
    peer = Peer("socketcan" if INTERFACE else "unix", (NODE,))
    peer.axes[NODE].position_turns = HERE_TURNS
    async with living(peer):
        yield peer


@pytest.fixture
def axis(peer):
    return peer.axes[NODE]


@pytest.fixture
async def rig(peer):
    joint = JointSpec(
        index=0, name="turret", profile=shipped_profile("odrive-0.6-position"), unit=NODE,
        zero_count=ZERO_COUNT, position_velocity_rad_s=20.0,
    )  # fmt: skip
    spec = LineSpec(
        index=0, name="can0", kind="can", port=peer.address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine="rt", joints=(joint,),
        watchdog_s=30.0,
    )  # fmt: skip
    async with running(spec) as rig:
        yield rig


async def more_inputs(axis):
    came = len(axis.inputs())
    await until(lambda: len(axis.inputs()) > came + 10)


async def test_before_it_has_power_its_input_is_its_own_position(rig, axis):
    await rig.ready()
    await more_inputs(axis)
    assert set(axis.inputs()) == {(HERE_TURNS, 0, 0)}
    assert axis.mode == (POSITION_CONTROL, PASS_THROUGH)
    await rig.arm()
    rig.loop.enabled = True
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 20, "it could have moved")
    assert (axis.state, axis.position_turns) == (CLOSED_LOOP, HERE_TURNS)


async def test_it_goes_to_its_angle_in_turns_from_its_zero(rig, axis):
    await rig.arm()
    armed = len(axis.inputs())
    rig.loop.position_rad = {0: 0.5}
    wanted = pytest.approx(ZERO_COUNT / 8192 + 0.5 / math.tau, abs=1e-6)
    await rig.drive(lambda: axis.position_turns == wanted, "it is there")
    assert axis.inputs()[armed] == (HERE_TURNS, 0, 0), "the first one is where it was"
    rig.loop.position_rad = {0: math.nan}
    came = len(axis.inputs())
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 20)
    assert len(axis.inputs()) <= came + 2, "what was in transit"
    assert axis.position_turns == wanted


@pytest.mark.parametrize("place", [math.nan, math.inf, -2000.0])
async def test_a_position_that_is_not_finite_or_out_of_range_gets_no_power(rig, axis, place):
    await rig.ready()
    axis.position_turns = place
    await until(lambda: not _known(rig), "what was known of its place is too old")
    with pytest.raises(HalError):
        await rig.line.arm()
    assert CLOSED_LOOP not in axis.states()
    assert all(turns == HERE_TURNS for turns, _, _ in axis.inputs())


def _known(rig):
    """Return whether a sample of the last 1.5 s has a position within 1000 turns."""
    feedback = rig.loop.exchange.take_feedback(0)
    place = feedback.count / 8192 if feedback.count < 1 << 31 else feedback.count / 8192 - 524288
    fresh = rig.loop.put_ns - feedback.stamp_ns < 1_500_000_000
    return fresh and abs(place) <= 1000.0


async def test_old_set_points_stop_it_in_velocity_control_and_then_take_its_power(rig, axis):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5}
    await rig.drive(lambda: axis.position_turns > HERE_TURNS, "it moves")
    rig.loop.running = False
    await until(lambda: axis.state == IDLE, "its power is off")
    stop = max(at for at, (command, data) in enumerate(axis.received)
               if command == MODE and data[0] == VELOCITY_CONTROL)  # fmt: skip
    commands = [command for command, _ in axis.received[stop:]]
    assert commands[1] == INPUT_VELOCITY
    assert STATE in commands
    assert set(axis.velocities()) == {0.0}
    later = [data for command, data in axis.received[stop:] if command == INPUT_POSITION]
    assert {struct.unpack("<fhh", data) for data in later} <= {(axis.position_turns, 0, 0)}
    assert commands.count(MODE) == 1, "no position control any more"
    await until(lambda: rig.states() == {DriveState.READY})


async def test_an_axis_without_a_reference_refuses_and_is_not_armed(rig, axis):
    await rig.ready()
    axis.stuck = True  # as firmware 0.6 does with absolute_setpoints
    async with asyncio.timeout(30.0):
        with pytest.raises(HalError, match="axis_state"):
            await rig.line.arm()
    assert rig.states() == {DriveState.READY}
