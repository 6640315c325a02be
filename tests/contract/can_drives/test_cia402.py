# SPDX-License-Identifier: Apache-2.0
"""CiA 402 over CANopen, against a node that another project has written."""

import math

import pytest
from cia402_node import FAULT, OPERATION, QUICK_STOP_ACTIVE, SWITCH_ON_DISABLED, Cia402Node
from loop_side import running, until
from scripted_odrive import BUSES, engine_asked, new_address, open_bus

from motord.config.drives.load import find_profile, load_profile
from motord_hal.base.errors import DriveFault, HalError
from motord_hal.base.paths import config_dir
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec

RPM = 2 * math.pi / 60
NODE = 5
INTERRUPTIONS_MAX = 20


@pytest.fixture(params=[kind for kind in BUSES if kind != "virtual"])
async def node(request):
    address = new_address(request.param)
    node = Cia402Node(open_bus(address), NODE)
    node.address, node.engine = address, engine_asked(request.param)
    yield node
    node.close()


def spec_of(node, profile=None):
    profile = profile or find_profile("cia402")
    joint = JointSpec(index=0, name="wheel", profile=profile, unit=NODE)
    return LineSpec(
        index=0, name="can0", kind="can", port=node.address, baudrate=500000, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine=node.engine, joints=(joint,),
        watchdog_s=0.5,
    )  # fmt: skip


@pytest.fixture
async def rig(node):
    async with running(spec_of(node)) as rig:
        yield rig


async def test_the_dictionary_is_written_and_read_back_and_nothing_is_armed(rig, node):
    await rig.ready()
    assert node.get(0x1400, 1) == 0x200 + NODE
    assert [node.get(0x1600, sub) for sub in (0, 1, 2)] == [2, 0x60400010, 0x60FF0020]
    assert [node.get(0x1A00, sub) for sub in range(4)] == [3, 0x60410010, 0x606C0020, 0x603F0010]
    assert (node.get(0x1400, 5), node.get(0x1017)) == (500, 100)
    assert node.get(0x6060) == 3
    assert node.operational
    assert node.status != OPERATION
    assert set(node.velocities) <= {0}


async def test_the_state_machine_is_walked_and_velocity_and_position_are_exchanged(rig, node):
    await rig.arm()
    assert node.status == OPERATION
    walked = list(dict.fromkeys(node.controls))
    assert [word for word in walked if word in (0x06, 0x07, 0x0F)] == [0x06, 0x07, 0x0F]
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: -60 * RPM}
    node.position = -1234
    await until(lambda: node.velocity == -60)

    def feedback():
        return rig.loop.exchange.take_feedback(0)

    await until(lambda: feedback().velocity_rad_s == pytest.approx(-60 * RPM))
    await until(lambda: feedback().count == (1 << 32) - 1234)
    assert feedback().enabled is True


async def words_while_armed(rig, node):
    """Arm the drive; return more than 20 control words since then. Return an empty list if it was
    disarmed meanwhile: the machine stood still, so that set-points got old."""
    await rig.arm()
    begin = len(node.controls)
    await until(lambda: len(node.controls) > begin + 20 or rig.states() != {DriveState.ARMED})
    words = node.controls[begin:]
    return words if rig.states() == {DriveState.ARMED} else []


async def test_the_control_word_stays_while_set_points_are_sent(rig, node):
    for _ in range(INTERRUPTIONS_MAX):
        words = await words_while_armed(rig, node)
        if words:
            break
    assert len(words) > 20
    assert set(words) == {0x0F}


async def test_old_set_points_cause_a_quick_stop_and_then_a_power_off(rig, node):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 60 * RPM}
    await until(lambda: node.velocity == 60)
    rig.loop.running = False
    await until(lambda: rig.states() == {DriveState.READY} or node.status == QUICK_STOP_ACTIVE)
    await until(lambda: node.status != OPERATION)
    await until(lambda: node.velocity == 0)
    await until(lambda: node.controls[-1] == 0x00)


async def test_a_fault_is_reported_and_reset_by_an_edge(rig, node):
    await rig.arm()
    node.error_code, node.status = 0x3220, FAULT
    await until(lambda: EventKind.DRIVE_FAULT in rig.kinds())
    assert rig.line.drive_faults == {"wheel": ("under-voltage",)}
    await rig.ready()
    with pytest.raises(DriveFault, match="under-voltage"):
        await rig.line.arm()
    await rig.line.clear_faults()
    assert node.status != FAULT
    await rig.line.arm()
    assert node.status == OPERATION


async def test_a_drive_that_does_not_follow_is_not_armed(rig, node):
    await rig.ready()
    node.stuck = True
    with pytest.raises(DriveFault, match="status_word"):
        await rig.line.arm()
    assert rig.states() == {DriveState.READY}


async def test_a_drive_that_lost_its_power_is_set_up_again_disarmed(rig, node):
    await rig.arm()
    node.reboot()
    await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
    await rig.ready()
    assert node.get(0x1600, 2) == 0x60FF0020
    assert node.status != OPERATION


async def test_a_refused_object_is_named_and_keeps_the_drive_from_ready(node):
    del node.node.object_dictionary[0x605A]
    async with running(spec_of(node)) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        assert "quick_stop_option refused with 0x06020000" in rig.events[-1].text


async def test_a_profile_may_name_any_number_of_objects(node, tmp_path):
    named = (config_dir() / "drives/cia402.toml").read_text(encoding="utf-8")
    more = "".join(
        f'[object.maker_s_{number}]\nindex = {0x2000 + number}\ntype = "u16"\n\n'
        for number in range(100)
    )
    path = tmp_path / "cia402.toml"
    path.write_text(named.replace("[channel.1]", f"{more}[channel.1]"), encoding="utf-8")
    async with running(spec_of(node, load_profile(path))) as rig:
        await rig.ready()
        assert await rig.line.read_register("wheel", "bus_voltage") == pytest.approx(36.5)
        with pytest.raises(HalError, match="maker_s_99 refused with 0x06020000"):
            await rig.line.read_register("wheel", "maker_s_99")


async def test_registers_are_objects(rig, node):
    await rig.ready()
    assert await rig.line.read_register("wheel", "bus_voltage") == pytest.approx(36.5)
    assert await rig.line.read_register("wheel", "device_type") == 0x00020192
    assert node.status == SWITCH_ON_DISABLED


async def left_turning(node):
    """Leave the node as a killed daemon does: mapped, operational, with power, at speed."""
    async with running(spec_of(node)) as rig:
        await rig.arm()
    await until(lambda: node.silent_s > 0.3, "that program has ended")
    node.status, node.velocity = OPERATION, 60
    node.controls.clear()
    node.operational_at.clear()


async def test_a_drive_that_turns_is_stopped_before_it_leaves_operational(node):
    await left_turning(node)
    async with running(spec_of(node)) as rig:
        await until(lambda: node.velocity == 0)
        assert (node.controls[0], node.operational_at[0]) == (0x02, True)
        await rig.ready()
        assert node.status != OPERATION


async def test_a_drive_that_turns_is_stopped_even_when_its_set_up_fails(node):
    await left_turning(node)
    del node.node.object_dictionary[0x605A]
    async with running(spec_of(node)) as rig:
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
        assert "quick_stop_option refused" in rig.events[-1].text
        assert node.velocity == 0
        assert node.status != OPERATION


async def test_a_drive_that_turns_and_is_pre_operational_is_stopped_when_its_set_up_begins(node):
    await left_turning(node)
    node.node.nmt.state = "PRE-OPERATIONAL"
    del node.node.object_dictionary[0x605A]
    async with running(spec_of(node)):
        await until(lambda: node.velocity == 0)
        assert node.status != OPERATION


@pytest.mark.parametrize("state", ["OPERATIONAL", "PRE-OPERATIONAL"])
async def test_stop_all_stops_a_drive_that_no_program_drives_in_either_state(node, state):
    await left_turning(node)
    node.node.nmt.state = state
    assert await halt_line(spec_of(node)) == []
    assert node.velocity == 0
    assert node.status != OPERATION
    assert set(node.controls) <= {0x02, 0x00}


async def test_a_pre_operational_drive_that_keeps_its_power_is_reported(node):
    await left_turning(node)
    node.node.nmt.state, node.stuck = "PRE-OPERATIONAL", True
    (problem,) = await halt_line(spec_of(node))
    assert problem == "wheel: reports that it is still enabled"
