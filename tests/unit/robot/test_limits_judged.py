# SPDX-License-Identifier: Apache-2.0
"""Limits that are set at run time are judged as those of the robot file: by what the wheels can do,
by how far a stop goes, and by what the file allows."""

import math
from pathlib import Path

import pytest

from motord.api.local_rpc import NEEDS_FORCE
from motord.config import load_robot
from motord.config.sections.joint.limits import JointLimits
from motord.daemon.parameters import joint as joint_parameters
from motord.daemon.parameters import robot as parameters
from motord.local_socket.server import INVALID_PARAMS, RpcError

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
SPEED, FALL, JERK = "limits.linear_m_s", "limits.linear_deceleration_m_s2", "limits.linear_m_s3"
WHEELS_M_S = 1.2


@pytest.fixture
def robot():
    """A robot whose file allows 0.5 m/s on wheels that do 1.2 m/s."""
    top = f"joint.left.velocity_max_rad_s={WHEELS_M_S / 0.0825}"
    return load_robot(ROBOTS / "demo.toml", ("limits.linear_m_s=0.5", top))


def refusal(robot, now, wanted, **more):
    with pytest.raises(RpcError) as caught:
        parameters.changed(robot, now, wanted, **more)
    return caught.value


def test_a_speed_above_the_files_needs_force_and_the_answer_has_both_stops(robot):
    error = refusal(robot, robot.limits, {SPEED: 1.1})
    assert error.code == NEEDS_FORCE
    assert "1.1 m/s is above the robot file's 0.5 m/s" in str(error)
    assert "a stop from 1.1 m/s goes 0.51 m, by the robot file 0.13 m" in str(error)
    assert "--force" in str(error)
    assert parameters.changed(robot, robot.limits, {SPEED: 1.1}, force=True).linear_m_s == 1.1


@pytest.mark.parametrize("value", [WHEELS_M_S * 1.01, 3.0, 20.0, 50.0])
@pytest.mark.parametrize("force", [False, True])
def test_no_speed_above_what_the_wheels_can_do_is_taken(robot, value, force):
    error = refusal(robot, robot.limits, {SPEED: value}, force=force)
    assert error.code == INVALID_PARAMS
    assert "0.001 to 1.2 m/s" in str(error)
    assert "the wheels can do no more" in str(error)


def test_the_range_that_is_shown_is_the_range_that_is_taken(robot):
    about = parameters.listed(robot, robot.limits)[SPEED]
    assert about["maximum"] == pytest.approx(WHEELS_M_S)
    assert about["from_file"] == 0.5
    assert parameters.changed(robot, robot.limits, {SPEED: about["maximum"]}, force=True)


def test_a_file_whose_limit_its_wheels_never_reach_can_be_restored():
    robot = load_robot(ROBOTS / "demo.toml", ("joint.left.velocity_max_rad_s=4",))
    slow = parameters.changed(robot, robot.limits, {SPEED: 0.2})
    assert parameters.changed(robot, slow, {SPEED: 1.0}) == robot.limits
    assert refusal(robot, slow, {SPEED: 1.01}, force=True).code == INVALID_PARAMS


def test_a_longer_stop_needs_force_though_no_value_is_above_the_files(robot):
    for wanted in ({FALL: 0.5}, {JERK: 0.5}, {FALL: 0.5, JERK: 0.5}):
        error = refusal(robot, robot.limits, wanted)
        assert error.code == NEEDS_FORCE
        assert "a stop from 0.5 m/s goes" in str(error)
    gentle = parameters.changed(robot, robot.limits, {SPEED: 0.2, FALL: 0.5})
    assert (gentle.linear_m_s, gentle.linear_deceleration_m_s2) == (0.2, 0.5)


def test_turning_and_sideways_motion_are_judged_as_driving_is():
    robot = load_robot(ROBOTS / "mecanum4.toml")
    for axis in ("angular_rad_s", "lateral_m_s"):
        own = getattr(robot.limits, axis)
        error = refusal(robot, robot.limits, {f"limits.{axis}": own * 1.1})
        assert error.code == NEEDS_FORCE
        assert axis in str(error)
        assert refusal(robot, robot.limits, {f"limits.{axis}": 49.0}, force=True)


def test_what_is_in_force_by_force_can_be_lowered_without(robot):
    fast = parameters.changed(robot, robot.limits, {SPEED: 1.1}, force=True)
    assert parameters.changed(robot, fast, {SPEED: 1.0}).linear_m_s == 1.0
    assert parameters.changed(robot, fast, {SPEED: 0.5}) == robot.limits


def test_a_stop_that_takes_too_long_is_refused_by_force_too(robot):
    error = refusal(robot, robot.limits, {FALL: 0.001}, force=True)
    assert (error.code, "s to rest" in str(error)) == (INVALID_PARAMS, True)


def test_no_limit_where_the_file_has_one_needs_force(robot):
    assert refusal(robot, robot.limits, {JERK: None}).code == NEEDS_FORCE
    made = parameters.changed(robot, robot.limits, {JERK: None}, force=True)
    assert made.linear_m_s3 == math.inf


def test_a_joint_without_a_base_is_judged_by_its_own_file():
    robot = load_robot(ROBOTS / "pan-tilt.toml")
    limits = {name: JointLimits.of(joint) for name, joint in robot.joint.items()}
    own = limits["pan"].acceleration_max_rad_s2
    resting = [0.0] * len(robot.joint)
    for value in (own * 2.0, own / 2.0):  # above the file; a stop that takes longer
        wanted = {"joint.pan.acceleration_max_rad_s2": value}
        with pytest.raises(RpcError, match=r"robot file.*--force") as caught:
            joint_parameters.changed(robot, limits, wanted, resting)
        assert caught.value.code == NEEDS_FORCE
        assert joint_parameters.changed(robot, limits, wanted, resting, force=True)
