# SPDX-License-Identifier: Apache-2.0
"""Cyclic synchronous velocity over CANopen, against a node that another project has written."""

import dataclasses
import math
import time

import can
import pytest
from cia402_node import OPERATION, SWITCH_ON_DISABLED, Cia402Node
from loop_side import running, until
from shared_bus import end_of

from motord.config.drives.load import find_profile
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec
from motord_hal.realtime.exchange import Exchange

RPM = 2 * math.pi / 60
NODES = (5, 6)
CYCLE_HZ = 100.0


@pytest.fixture
def address(bus):
    return bus[0]


@pytest.fixture
def nodes(address):
    nodes = [Cia402Node(end_of(address), number) for number in NODES]
    yield nodes
    for node in nodes:
        node.close()


@pytest.fixture
def turning(nodes):
    """The nodes as a killed daemon leaves them: with power, and no longer operational."""
    for node in nodes:
        node.status, node.velocity, node.node.nmt.state = OPERATION, 60, "PRE-OPERATIONAL"
    return nodes


@pytest.fixture
def spec(bus):
    address, engine = bus
    profile = find_profile("cia402-csv")
    joints = tuple(
        JointSpec(index=index, name=f"wheel_{number}", profile=profile, unit=number)
        for index, number in enumerate(NODES)
    )
    return LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=CYCLE_HZ, gap_s=None, engine=engine, joints=joints,
        watchdog_s=0.5,
    )  # fmt: skip


@pytest.fixture
async def rig(nodes, spec):
    async with running(spec) as rig:
        yield rig


async def test_mode_nine_is_set_with_the_line_s_cycle_and_speeds_that_wait_for_sync(rig, nodes):
    await rig.ready()
    for node in nodes:
        assert (node.get(0x6060), node.get(0x6061)) == (9, 9)
        assert (node.get(0x60C2, 1), node.get(0x60C2, 2)) == (10, -3)
        assert (node.get(0x1400, 2), node.get(0x1600, 1)) == (255, 0x60400010)
        assert (node.get(0x1401, 2), node.get(0x1601, 1)) == (1, 0x60FF0020)
        assert (node.get(0x1801, 2), node.get(0x1A01, 1)) == (1, 0x60640020)
        assert node.get(0x1401, 5) == 500
        assert set(node.velocities) <= {0}


async def test_both_drives_turn_and_measure_with_one_sync_a_cycle(rig, nodes):
    await rig.arm()
    assert [node.status for node in nodes] == [OPERATION, OPERATION]
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM, 1: -90 * RPM}
    await until(lambda: [node.velocity for node in nodes] == [60, -90])
    nodes[0].position = -1234

    def feedback(index):
        return rig.loop.exchange.take_feedback(index)

    await until(lambda: feedback(0).velocity_rad_s == pytest.approx(60 * RPM))
    await until(lambda: feedback(1).velocity_rad_s == pytest.approx(-90 * RPM))
    await until(lambda: feedback(0).count == (1 << 32) - 1234)

    async def counted():
        """Return cycles and SYNCs right after a report: the engine in C reports periodically."""
        old = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles != old)
        return rig.line.stats().cycles, nodes[0].syncs

    cycles, syncs = await counted()
    await until(lambda: rig.line.stats().cycles > cycles + 50)
    cycles_later, syncs_later = await counted()
    assert abs((cycles_later - cycles) - (syncs_later - syncs)) <= 2


async def test_a_speed_without_a_sync_has_no_effect(nodes, spec, address):
    """The test sends the frames itself, to check how the other project's node maps them."""
    async with running(spec) as rig:
        await rig.arm()
    node = nodes[0]
    with end_of(address) as bus:
        bus.send(can.Message(arbitration_id=0x305, data=b"\x2a\0\0\0", is_extended_id=False))
        await until(lambda: node.waiting, "the speed has come, and no SYNC since")
        assert node.velocity == 0
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        await until(lambda: 42 in node.velocities, "the SYNC has come")


async def test_old_set_points_stop_all_drives_of_the_bus(rig, nodes):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM, 1: 60 * RPM}
    await until(lambda: [node.velocity for node in nodes] == [60, 60])
    rig.loop.running = False
    await until(lambda: all(node.status == SWITCH_ON_DISABLED for node in nodes))
    await until(lambda: [node.velocity for node in nodes] == [0, 0])
    await until(lambda: rig.states() == {DriveState.READY})


async def more_syncs(node):
    syncs = node.syncs
    await until(lambda: node.syncs > syncs + 10)


async def test_a_pause_of_this_program_makes_no_drive_unresponsive(rig, nodes):
    await rig.ready()
    for _ in range(3):
        time.sleep(0.5)  # noqa: ASYNC251  # no SYNC meanwhile
        await more_syncs(nodes[0])
    assert rig.states() == {DriveState.READY}
    assert EventKind.DRIVE_UNRESPONSIVE not in rig.kinds()


async def test_stop_all_stops_drives_that_no_longer_get_a_sync(nodes, spec):
    async with running(spec) as rig:
        await rig.arm()
    for node in nodes:
        node.status, node.velocity = OPERATION, 60  # as after a crash
    assert await halt_line(spec) == []
    assert all(node.status != OPERATION for node in nodes)
    assert [node.velocity for node in nodes] == [0, 0]


def test_a_cycle_that_the_drive_cannot_represent_is_refused(spec):
    odd = dataclasses.replace(spec, cycle_hz=300.0)
    with pytest.raises(ProfileError, match=r"cannot hold the line's cycle, 3\.333 ms"):
        open_line(odd, Exchange.private(), lambda event: None)


async def test_drives_that_turn_and_take_no_pdo_are_stopped_before_they_are_set_up(spec, turning):
    for node in turning:
        del node.node.object_dictionary[0x605A]  # so that its set-up fails
    async with running(spec) as rig:
        await until(lambda: all(node.velocity == 0 for node in turning))
        await until(lambda: rig.kinds().count(EventKind.DRIVE_UNRESPONSIVE) == len(turning))
    assert all(node.controls[0] == 0x02 for node in turning)
    assert all(node.status != OPERATION for node in turning)


async def test_stop_all_stops_drives_that_turn_and_take_no_pdo(spec, turning):
    assert await halt_line(spec) == []
    assert all(node.status == SWITCH_ON_DISABLED and node.velocity == 0 for node in turning)
