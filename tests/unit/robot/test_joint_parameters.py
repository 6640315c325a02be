# SPDX-License-Identifier: Apache-2.0
"""Limits of joints without a base as parameters: each has its own, in the range of its file."""

import math
from pathlib import Path

import pytest

from motord.bus.parameters import Tunable
from motord.commission.params_save import put_in_force
from motord.commission.robot_file_edit import RobotFileEdit
from motord.config import load_robot
from motord.config.sections.joint.limits import JointLimits
from motord.daemon.parameters import joint as joint_parameters
from motord.daemon.parameters import robot as parameters
from motord.local_socket.server import RpcError

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
BELT = """
[line.bus]
kind = "feetech"
port = "/dev/ttyACM1"
baudrate = 1000000
cycle_hz = 100

[joint.belt]
line = "bus"
drive = "sts3215"
unit = 7
velocity_max_rad_s = 4.0
acceleration_max_rad_s2 = 5.0
"""
STANDING = (0.0, 0.0, 0.0)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text((ROBOTS / "pan-tilt.toml").read_text("utf-8") + BELT, "utf-8")
    return path


@pytest.fixture
def robot(file):
    return load_robot(file)


@pytest.fixture
def limits(robot):
    return {name: JointLimits.of(joint) for name, joint in robot.joint.items()}


def test_each_joint_has_the_limits_that_its_drive_follows(robot, limits):
    listed = joint_parameters.listed(robot, limits)
    assert [name for name in listed if ".pan." in name] == [
        "joint.pan.velocity_max_rad_s",
        "joint.pan.acceleration_max_rad_s2",
    ]
    assert len([name for name in listed if ".belt." in name]) == 4
    assert listed["joint.belt.deceleration_max_rad_s2"]["value"] == 5.0
    assert listed["joint.belt.jerk_max_rad_s3"]["value"] is None
    assert listed["joint.belt.velocity_max_rad_s"]["maximum"] == 4.0
    assert parameters.listed(robot, robot.limits) == {}


def test_a_base_has_no_parameters_of_joints():
    base = load_robot(ROBOTS / "demo.toml")
    assert joint_parameters.listed(base, {}) == {}
    with pytest.raises(RpcError, match="no parameter"):
        joint_parameters.values(base, {}, ["joint.left.velocity_max_rad_s"])


def test_a_change_affects_only_the_named_joints(robot, limits):
    wanted = {"joint.belt.jerk_max_rad_s3": 30.0, "joint.belt.velocity_max_rad_s": 1.0}
    made = joint_parameters.changed(robot, limits, wanted, STANDING)
    assert made == {"belt": JointLimits(1.0, 5.0, 5.0, 30.0)}
    back = joint_parameters.changed(robot, made, {"joint.belt.jerk_max_rad_s3": None}, STANDING)
    assert back["belt"].jerk_max_rad_s3 == math.inf


def test_a_joint_that_takes_positions_brakes_as_it_accelerates(robot, limits):
    wanted = {"joint.pan.acceleration_max_rad_s2": 2.0}
    (made,) = joint_parameters.changed(robot, limits, wanted, STANDING, force=True).values()
    assert (made.acceleration_max_rad_s2, made.deceleration_max_rad_s2) == (2.0, 2.0)


REFUSED = {
    "joint.belt.velocity_max_rad_s": (4.5, "out of range"),
    "joint.belt.deceleration_max_rad_s2": (0.1, "from full speed it takes 40 s to rest"),
    "joint.belt.jerk_max_rad_s3": (True, "out of range"),
    "joint.pan.jerk_max_rad_s3": (1.0, "no parameter"),
    "joint.belt.velocity_max": (1.0, "did you mean joint.belt.velocity_max_rad_s"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_invalid_change_is_refused_with_the_reason(robot, limits, name):
    value, why = REFUSED[name]
    with pytest.raises(RpcError, match=why):
        joint_parameters.changed(robot, limits, {name: value}, STANDING)


def test_a_stop_from_the_present_speed_counts_too(robot, limits):
    wanted = {
        "joint.belt.velocity_max_rad_s": 0.5,
        "joint.belt.deceleration_max_rad_s2": 0.1,
    }
    assert joint_parameters.changed(robot, limits, wanted, STANDING, force=True)
    with pytest.raises(RpcError, match=r"joint\.belt\..*: from full speed it takes 40 s"):
        joint_parameters.changed(robot, limits, wanted, (0.0, 0.0, -4.0), force=True)


def test_a_slow_joint_gets_the_time_of_its_ramp_before_the_power_goes_off(limits):
    slow = JointLimits(4.0, 5.0, 0.5, 1.0)
    assert slow.ramp_s(-4.0) == pytest.approx(4.0 / 0.5 + 2.0 * 0.5)
    assert limits["belt"].ramp_s(0.0) == 0.0


def test_limits_in_force_go_into_the_robot_file(file, robot, limits):
    wanted = {"joint.belt.acceleration_max_rad_s2": 2.0, "joint.pan.velocity_max_rad_s": 0.5}
    in_force = limits | joint_parameters.changed(robot, limits, wanted, STANDING)
    edit = RobotFileEdit(file)
    put = put_in_force(edit, joint_parameters.values(robot, in_force))
    assert put == wanted | {"joint.belt.deceleration_max_rad_s2": 5.0}
    saved = edit.checked().joint
    assert {name: JointLimits.of(joint) for name, joint in saved.items()} == in_force


async def test_buses_show_limits_of_joints_and_no_measures_of_a_base(robot, limits):
    calls = []

    async def call(method, **params):
        calls.append((method, params))
        return joint_parameters.listed(robot, limits) | {"joint.belt.speed_loop.gain": {}}

    tunable = Tunable(robot, call)
    known = await tunable.known()
    assert set(known) == set(joint_parameters.listed(robot, limits))
    assert tunable.problem("limits.linear_m_s") is not None
    await tunable.change({"joint.belt.velocity_max_rad_s": 1.0})
    assert calls[-1] == ("params.set", {"joint.belt.velocity_max_rad_s": 1.0})
