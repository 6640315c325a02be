# SPDX-License-Identifier: Apache-2.0
"""Profile position over CANopen with its handshake, against a node that another project has
written."""

import math

import pytest
from cia402_node import NEW_SETPOINT, OPERATION, TAKEN, Cia402Node
from loop_side import running, until
from shared_bus import end_of
from tests.shipped import shipped_profile

from motord_hal.fieldbus.ports import DriveState, JointSpec, LineSpec

NODE = 5
HERE = -4321
COUNTS_PER_RAD = 10000 / math.tau


@pytest.fixture
def node(address):
    node = Cia402Node(end_of(address), NODE)
    node.position = HERE
    yield node
    node.close()


@pytest.fixture
async def rig(node, address):
    joint = JointSpec(
        index=0, name="turret", profile=shipped_profile("cia402-pp"), unit=NODE, zero_count=HERE,
        position_velocity_rad_s=20.0,
    )  # fmt: skip
    spec = LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine="rt", joints=(joint,), watchdog_s=2.0,
    )  # fmt: skip
    async with running(spec) as rig:
        yield rig


async def some_cycles(rig):
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 20)


async def test_mode_one_is_set_and_the_target_stands_before_the_control_word(rig, node):
    await rig.ready()
    assert (node.get(0x6060), node.get(0x6061)) == (1, 1)
    assert [node.get(0x1600, sub) for sub in (0, 1, 2)] == [2, 0x607A0020, 0x60400010]
    assert (node.get(0x6081), node.get(0x6083), node.get(0x6084)) == (3000, 30000, 30000)
    assert (node.get(0x6065), node.get(0x6066)) == (5000, 100)
    assert node.get(0x1400, 5) == 2000


async def test_a_drive_without_power_gets_its_own_position_and_no_new_set_point_bit(rig, node):
    await rig.ready()
    await some_cycles(rig)
    assert {target for target, _ in node.targets} <= {0, HERE}
    assert node.targets[-1][0] == HERE
    assert not any(word & NEW_SETPOINT for word in node.controls)
    await rig.arm()
    rig.loop.enabled = True
    await some_cycles(rig)
    assert (node.status, node.position, node.taken) == (OPERATION, HERE, [])


async def test_each_target_is_taken_with_a_rising_edge_and_the_last_one_is_where_it_ends(rig, node):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5}
    there = HERE + round(0.5 * COUNTS_PER_RAD)
    await rig.drive(lambda: node.position == there, "it is there")
    assert node.taken[0] == HERE, "the first one is where it was"
    assert node.taken == sorted(node.taken)
    came = len(node.taken)
    await rig.drive(lambda: len(node.taken) > came + 3, "the handshake continues")
    rig.loop.position_rad = {0: math.nan}
    await some_cycles(rig)
    assert node.position == there


async def test_a_new_target_waits_until_the_acknowledge_bit_is_clear(rig, node):
    await rig.arm()
    rig.loop.position_rad = {0: 0.0}
    await rig.drive(lambda: node.taken, "it has taken one")
    node.stuck = True  # it ignores its control word from now on
    node.more_status |= TAKEN
    rig.loop.position_rad = {0: 0.3}
    await some_cycles(rig)
    assert node.controls[-1] & NEW_SETPOINT == 0, "motord waits"
    assert node.position == HERE
    node.stuck = False
    there = HERE + round(0.3 * COUNTS_PER_RAD)
    await rig.drive(lambda: node.position == there, "it is there")


async def test_old_set_points_stop_it_and_it_takes_no_more_targets(rig, node):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5}
    await rig.drive(lambda: node.position > HERE, "it moves")
    rig.loop.running = False
    await until(lambda: node.controls[-1] == 0x00, "its power is off")
    stop = max(at for at, word in enumerate(node.controls) if word == 0x02)
    assert not any(word & NEW_SETPOINT for word in node.controls[stop:])
    assert node.status != OPERATION
    await until(lambda: rig.states() == {DriveState.READY})
