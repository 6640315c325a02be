# SPDX-License-Identifier: Apache-2.0
"""Cyclic synchronous position over CANopen, against a node that another project has written."""

import dataclasses
import math

import pytest
from cia402_node import FAULT, OPERATION, SWITCH_ON_DISABLED, Cia402Node
from loop_side import running, until
from shared_bus import end_of, shared_bus
from tests.shipped import shipped_profile

from motord_hal.drives.profile import Enabled
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec

NODES = (5, 6)
HERE = 1234
"""Position of the nodes when they are switched on; the target of a new node is 0."""
COUNTS_PER_RAD = 10000 / math.tau
REFERENCED = 0x8000


@pytest.fixture
def address():
    with shared_bus("unix") as address:
        yield address


@pytest.fixture
def nodes(address):
    nodes = [Cia402Node(end_of(address), number) for number in NODES]
    for node in nodes:
        node.position = HERE
    yield nodes
    for node in nodes:
        node.close()


def spec_of(address, **changes):
    profile = dataclasses.replace(shipped_profile("cia402-csp"), **changes)
    joints = tuple(
        JointSpec(
            index=index, name=f"joint_{number}", profile=profile, unit=number, zero_count=1000,
            position_velocity_rad_s=20.0,
        )
        for index, number in enumerate(NODES)
    )  # fmt: skip
    return LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine="rt", joints=joints, watchdog_s=0.5,
    )  # fmt: skip


@pytest.fixture
async def rig(nodes, address):
    async with running(spec_of(address)) as rig:
        yield rig


async def more_syncs(node):
    syncs = node.syncs
    await until(lambda: node.syncs > syncs + 10)


async def test_mode_eight_is_set_with_targets_that_wait_for_sync_and_a_window_around_them(
    rig, nodes
):
    await rig.ready()
    for node in nodes:
        assert (node.get(0x6060), node.get(0x6061)) == (8, 8)
        assert (node.get(0x60C2, 1), node.get(0x60C2, 2)) == (10, -3)
        assert (node.get(0x1400, 2), node.get(0x1600, 1)) == (255, 0x60400010)
        assert (node.get(0x1401, 2), node.get(0x1601, 1)) == (1, 0x607A0020)
        assert (node.get(0x1801, 2), node.get(0x1A01, 1)) == (1, 0x60640020)
        assert (node.get(0x6065), node.get(0x6066)) == (5000, 100)
        assert node.get(0x1401, 5) == 500


async def test_before_it_has_power_its_target_is_its_own_position_and_arming_moves_nothing(
    rig, nodes
):
    await rig.ready()
    await more_syncs(nodes[0])
    for node in nodes:
        assert {target for target, _ in node.targets} == {HERE}
    nodes[0].position = HERE + 300  # turned by hand
    await until(lambda: nodes[0].targets[-1][0] == HERE + 300)
    await rig.arm()
    rig.loop.enabled = True
    await more_syncs(nodes[0])
    assert [node.position for node in nodes] == [HERE + 300, HERE]
    assert [node.status for node in nodes] == [OPERATION, OPERATION]


async def test_both_go_to_their_angles_from_their_own_positions(rig, nodes):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5, 1: -0.25}
    wanted = [round(1000 + angle_rad * COUNTS_PER_RAD) for angle_rad in (0.5, -0.25)]
    await rig.drive(lambda: [node.position for node in nodes] == wanted, "they are there")
    for node in nodes:
        first = next(target for target, status in node.targets if status == OPERATION)
        assert first == HERE
    await rig.drive(lambda: rig.loop.exchange.take_feedback(1).count == wanted[1], "reported")
    rig.loop.position_rad = {}
    await more_syncs(nodes[0])  # targets that were in transit arrive
    sent = len(nodes[0].targets)
    await more_syncs(nodes[0])
    assert len(nodes[0].targets) == sent, "withheld: it holds its newest target"
    assert [node.position for node in nodes] == wanted


async def test_old_set_points_stop_it_by_its_quick_stop_and_take_its_power(rig, nodes):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5, 1: 0.5}
    await rig.drive(lambda: nodes[0].position > HERE + 300, "they move")
    rig.loop.running = False
    await until(lambda: all(node.controls[-1] == 0x00 for node in nodes))
    for node in nodes:
        assert 0x02 in node.controls
        assert node.status != OPERATION
    await until(lambda: rig.states() == {DriveState.READY})


async def test_a_following_error_of_the_drive_is_its_fault_and_ends_its_motion(rig, nodes):
    await rig.arm()
    rig.loop.position_rad = {0: 0.3, 1: 0.3}
    await rig.drive(lambda: nodes[0].position > HERE, "they move")
    nodes[0].status, nodes[0].error_code = FAULT, 0x8611
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    assert any("following error" in event.text for event in rig.events)
    await until(lambda: rig.line.drive_states["joint_5"] is DriveState.READY)


async def test_whether_it_is_homed_comes_from_its_bit(address, nodes):
    """The manual of this drive names a bit of the status word for that."""
    homed = Enabled(register="status_word", mask=REFERENCED, equals=REFERENCED)
    async with running(spec_of(address, absolute=False, homed=homed)) as rig:

        def referenced():
            return [rig.loop.exchange.take_feedback(n).referenced for n in (0, 1)]

        await rig.ready()
        await until(lambda: referenced() == [0, 0], "not homed")
        nodes[1].more_status = REFERENCED
        await until(lambda: referenced() == [0, 1], "one is")
        nodes[1].more_status = 0
        await until(lambda: referenced() == [0, 0], "and has lost it")


async def test_stop_all_stops_drives_while_they_move(nodes, address):
    async with running(spec_of(address)) as rig:
        await rig.arm()
    for node in nodes:
        node.status = OPERATION  # as after a crash
    assert await halt_line(spec_of(address)) == []
    assert all(node.status == SWITCH_ON_DISABLED for node in nodes)
