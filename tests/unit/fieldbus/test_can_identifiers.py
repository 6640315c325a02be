# SPDX-License-Identifier: Apache-2.0
"""Drives on one CAN bus share no identifier, as the wire knows it: 11 and 29 bits, what motord
sends and what the drives send, with all that their protocols reserve."""

import functools
from dataclasses import replace

import pytest

from motord.config import load_robot
from motord.config.drives.load import find_profile, list_profiles, load_profile
from motord.config.problems import ConfigError
from motord.config.wiring import line_specs
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir
from motord_hal.can.identifiers import OwnFrames, can_plans, clashes
from motord_hal.can.plan import CanPlan, Sent
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.exchange import Exchange

ROBOT = config_dir() / "robots" / "odrive-two.toml"
profile_of = functools.cache(find_profile)


def plan_of(drive, place=0):
    """Return the plan of a drive, given as "PROFILE NODE"."""
    name, node = drive.split()
    joint = JointSpec(index=place, name=f"j{place}", profile=profile_of(name), unit=int(node))
    return CanPlan([joint])


def clashes_of(*drives):
    return list(clashes([plan_of(drive, place) for place, drive in enumerate(drives)]))


def robot_of(left, right, *more):
    """Load a robot on two drives, each "PROFILE NODE"."""
    keys = [
        f"joint.{joint}.{key}={value}"
        for joint, drive in (("left", left), ("right", right))
        for key, value in zip(("drive", "unit"), drive.split(), strict=True)
    ]
    return load_robot(ROBOT, (*keys, *more))


def refusal(left, right, *more):
    with pytest.raises(ConfigError) as error:
        robot_of(left, right, *more)
    return "\n".join(map(str, error.value.problems))


@pytest.mark.parametrize(
    ("left", "right", "identifier"),
    [
        # what motord sends to the one is what it sends to the other
        ("odrive-0.6 16", "cia402 13", 0x20D),
        # a PDO of the node
        ("odrive-0.6 12", "cia402 1", 0x181),
        ("odrive-0.6 20", "cia402 1", 0x281),
        # PDOs of the node that motord does not use, but which the node has as delivered
        ("odrive-0.6 24", "cia402 1", 0x301),
        ("odrive-0.6 32", "cia402 1", 0x401),
        # SDO, in both directions
        ("odrive-0.6 48", "cia402 1", 0x601),
        ("odrive-0.6 44", "cia402 1", 0x581),
        # heartbeat
        ("odrive-0.6 56", "cia402 1", 0x701),
        # EMCY, and SYNC
        ("odrive-0.6 4", "cia402 1", 0x081),
        ("odrive-0.6 4", "cia402-csv 100", 0x080),
        # NMT
        ("odrive-0.6 0", "cia402 100", 0x000),
        # frames of the ODrive that motord does not use: Set_Input_Pos
        ("odrive-0.6 16", "cia402 12", 0x20C),
        # the same node of two profiles of one protocol
        ("odrive-0.6 1", "odrive-0.5 1", 0x021),
        ("cia402 5", "cia402-csv 5", 0x085),
        ("vesc 3", "vesc-duty 3", 0x903),
        # the reply of one is a PDO of the other; a command of one is a frame of the other
        ("rmd 1", "cia402 65", 0x241),
        ("rmd 1", "odrive-0.6 10", 0x141),
        # moteus sends identifiers up to 0x7FF with 11 bits: node 1 answers as 0x100
        ("moteus 1", "odrive-0.6 8", 0x100),
        # it takes each identifier of 11 bits whose lowest byte is its node
        ("moteus 1", "cia402 1", 0x201),
    ],
)
def test_two_drives_with_one_identifier_are_found(left, right, identifier):
    for drives in ((left, right), (right, left)):
        (clash,) = clashes_of(*drives)
        assert identifier in clash.identifiers


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("odrive-0.6 1", "vesc 1"),
        ("odrive-0.6 1", "odrive-0.6 2"),
        ("odrive-0.6 9", "cia402 1"),
        ("cia402 1", "cia402-csv 2"),
        ("cia402-csv 1", "cia402-csp 2"),
        ("vesc 1", "vesc-duty 2"),
        # both would obey 0x401, but neither sends it, nor does motord
        ("rmd 1", "cia402 1"),
        ("moteus 33", "odrive-0.6 8"),
        ("dbc-example 1", "vesc 1"),
    ],
)
def test_drives_that_never_meet_are_not_found(left, right):
    assert clashes_of(left, right) == []


def test_check_names_both_owners():
    message = refusal("odrive-0.6 16", "cia402 13")
    assert "joint.right.unit: identifier 0x20d (11 bits) is set_input_velocity of" in message
    assert '"odrive-0.6" node 16 (joint left)' in message
    assert 'rpdo_1 of "cia402" node 13 (joint right)' in message


def text_of(name):
    return (config_dir() / "drives" / f"{name}.toml").read_text("utf-8")


CAN_PROFILES = [name for name in list_profiles() if '\nprotocol = "can"' in text_of(name)]


@pytest.mark.parametrize("name", CAN_PROFILES)
def test_drives_of_one_profile_with_different_nodes_never_meet(name):
    table = profile_of(name).can
    if table.node_min == table.node_max:
        pytest.skip("has one address")
    nodes = sorted({table.node_min, table.node_min + 1, (table.node_max + 1) // 2, table.node_max})
    assert clashes_of(*(f"{name} {node}" for node in nodes)) == []


def test_both_drives_with_one_number_get_their_own_frames():
    """An ODrive and a VESC may both be number 1."""
    robot = robot_of("odrive-0.6 1", "vesc 1")
    spec = line_specs(robot, robot.profiles)[0]
    plans = can_plans(spec)
    assert [(plan.profile.name, plan.node) for plan in plans] == [("odrive-0.6", 1), ("vesc", 1)]
    assert [joint.name for plan in plans for joint in plan.joints] == ["left", "right"]


@pytest.mark.parametrize("engine", ["rt", "asyncio"])
def test_a_line_refuses_drives_that_share_an_identifier_too(engine):
    robot = robot_of("odrive-0.6 1", "cia402 1", f"line.can0.engine={engine}")
    spec = line_specs(robot, robot.profiles)[0]
    joints = tuple(
        replace(joint, unit=unit) for joint, unit in zip(spec.joints, (16, 13), strict=True)
    )
    with pytest.raises(ProfileError, match="0x20d"):
        open_line(replace(spec, joints=joints), Exchange.private(), print)


def test_a_frame_that_both_sides_send_is_no_profile(tmp_path):
    text = text_of("odrive-0.6")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("id = 0x00D", "id = 0x009").replace('"odrive-0.6"', '"mine"'))
    with pytest.raises(ProfileError, match=r"is sent by motord .* and by the drive"):
        load_profile(path)


def test_what_a_profile_reserves_is_compared(tmp_path):
    text = text_of("vesc").replace('"vesc"', '"mine"')
    reserved = '[reserved.other]\nid = 0x20D\nextended = false\naddressed = false\nsource = "p. 1"'
    path = tmp_path / "mine.toml"
    path.write_text(f"{text}\n{reserved}\n")
    message = refusal(f"{path} 1", "cia402 13")
    assert "0x20d" in message
    assert "reserved" in message


def test_what_a_dbc_file_has_is_compared_though_the_profile_does_not_use_it():
    """The example's DRV_Version, 0x701 for node 1, is no frame of its profile."""
    (clash,) = clashes_of("dbc-example 5", "odrive-0.6 56")
    assert 0x705 in clash.identifiers


def test_of_each_frame_that_motord_has_sent_one_copy_may_come_back():
    own, key = OwnFrames(), (0x201, False, False)
    for data in (b"\1", b"\2", b"\2"):
        own.sent(Sent(0x201, extended=False, fd=False, data=data))
    assert not own.came(key, b"\3")  # another node's
    assert not own.came((0x201, True, False), b"\1")  # another identifier
    assert own.came(key, b"\2")  # the first one was lost
    assert own.came(key, b"\2\0\0")  # FD frames are padded
    assert not own.came(key, b"\2")
    assert not own.came(key, b"\1")
