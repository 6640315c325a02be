# SPDX-License-Identifier: Apache-2.0
"""Poses in which a person can judge steered wheels."""

from pathlib import Path

import pytest

from motord.commission.spin.steered_poses import (
    modules_of,
    opposite,
    patterns,
    poses_of,
    standing,
    straight,
)
from motord.config import load_robot
from motord.daemon.report import modules

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


def modules_in(name):
    robot = load_robot(ROBOTS / f"{name}.toml")
    return modules_of({"modules": modules(robot)}), robot.base.strafes


@pytest.mark.parametrize("name", ["ackermann-servo", "swerve4-servos"])
def test_no_two_wheels_have_equal_or_opposite_patterns(name):
    found, strafes = modules_in(name)
    shown = patterns(poses_of(found, strafes=strafes))
    both = [*shown.values(), *map(opposite, shown.values())]
    assert len(set(both)) == 2 * len(shown)


@pytest.mark.parametrize("name", ["ackermann-servo", "swerve4-servos"])
def test_poses_are_within_the_range(name):
    found, strafes = modules_in(name)
    for pose in [straight(found), *poses_of(found, strafes=strafes)]:
        for one in found:
            if one.steering:
                low_rad, high_rad = one.range_rad
                assert low_rad <= pose.aim_rad[one.steering] <= high_rad
    assert set(straight(found).aim_rad.values()) == {0.0}


def test_a_turn_about_a_wheel_leaves_it_at_rest():
    found, _ = modules_in("swerve4-servos")
    for one in found:
        pose = standing(found, one.traction)
        assert pose.linear - one.y_m * pose.angular == pytest.approx(0.0)
        assert pose.lateral + one.x_m * pose.angular == pytest.approx(0.0)


def test_a_base_without_steered_wheels_has_no_modules():
    assert modules_in("demo")[0] == []
