# SPDX-License-Identifier: Apache-2.0
"""Cyclic synchronous torque over CANopen, against a node that another project has written: the
core's speed loop turns it."""

import math

import pytest
from cia402_node import OPERATION, SWITCH_ON_DISABLED, Cia402Node
from loop_side import running, until
from shared_bus import end_of

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec

RPM = 2 * math.pi / 60
NODE = 5
SPEED_RPM = 120


@pytest.fixture
def node(bus):
    node = Cia402Node(end_of(bus[0]), NODE)
    yield node
    node.close()


@pytest.fixture
def spec(bus):
    address, engine = bus
    joint = JointSpec(
        index=0, name="wheel", profile=find_profile("cia402-torque"), unit=NODE, inverted=True
    )
    return LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=200.0, gap_s=None, engine=engine, joints=(joint,), watchdog_s=0.5,
    )  # fmt: skip


@pytest.fixture
async def rig(node, spec):
    async with running(spec) as rig:
        yield rig


async def turning(rig, node):
    await rig.arm()
    rig.loop.velocity_rad_s = {0: SPEED_RPM * RPM}
    await rig.drive(
        lambda: abs(node.velocity + SPEED_RPM) < 6, "it turns as commanded, in the other direction"
    )


async def test_mode_ten_is_set_with_its_limits_and_no_torque(rig, node):
    await rig.ready()
    assert (node.get(0x6060), node.get(0x6061)) == (10, 10)
    assert (node.get(0x6072), node.get(0x6080)) == (1500, 3500)
    assert (node.get(0x1600, 1), node.get(0x1601, 1)) == (0x60400010, 0x60710010)
    assert (node.get(0x1401, 2), node.get(0x1401, 5)) == (1, 500)
    assert set(node.torques) <= {0}


async def test_a_motor_of_another_rated_torque_is_not_set_up(node, spec):
    node.put(0x6076, 640)
    async with running(spec) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        assert "rated_torque" in rig.events[-1].text
        assert rig.states() != {DriveState.READY}
    assert node.status != OPERATION


async def test_the_speed_loop_turns_it_within_the_drive_s_limit(rig, node):
    await turning(rig, node)
    assert max(map(abs, node.torques)) <= 1500
    assert min(node.torques) < -100
    wanted = pytest.approx(SPEED_RPM * RPM, abs=6 * RPM)
    await until(lambda: rig.loop.exchange.take_feedback(0).velocity_rad_s == wanted)


async def test_old_set_points_give_zero_torque_a_quick_stop_and_no_power(rig, node):
    await turning(rig, node)
    rig.loop.running = False
    await until(lambda: rig.states() == {DriveState.READY})
    await until(lambda: node.status != OPERATION)
    assert 0x02 in node.controls
    await until(lambda: node.torque == 0)


async def test_disarming_gives_zero_torque_and_no_power(rig, node):
    await turning(rig, node)
    await rig.line.disarm()
    await until(lambda: node.status != OPERATION)
    await until(lambda: node.torque == 0)


@pytest.mark.parametrize("state", ["OPERATIONAL", "PRE-OPERATIONAL"])
async def test_stop_all_takes_torque_and_power(node, spec, state):
    async with running(spec) as rig:
        await rig.arm()
    node.status, node.torque, node.node.nmt.state = OPERATION, 500, state  # as after a crash
    assert await halt_line(spec) == []
    assert node.status == SWITCH_ON_DISABLED
