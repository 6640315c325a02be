# SPDX-License-Identifier: Apache-2.0
"""Gains of the speed loops as parameters of a running daemon: the file of a robot on duties lacks
its friction, and gains that are set while it drives bring it to its speed."""

import pytest
from tests.sim.daemon_stage import ROOT, wait_until
from tests.sim.person_stage import at_terminal, copied, robot_of

from motord.client import ClientError
from motord.config import load_robot

FORWARD_ONLY = ROOT / "config/robots/forward-only.toml"
GAIN, INTEGRAL = "joint.left.speed_loop.gain_s_per_rad", "joint.left.speed_loop.integral_per_rad"
GAINS = {name.replace("left", side): value for side in ("left", "right")
         for name, value in ((GAIN, 0.05), (INTEGRAL, 0.4))}  # fmt: skip
SPEED_M_S, RADIUS_M = 0.4, 0.05


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gains")
    file = copied(folder, FORWARD_ONLY)
    wheels = ("left.coulomb_n_m=1.2", "right.coulomb_n_m=1.2")
    with robot_of(folder, file, wheels=wheels) as stage:
        stage.file = file
        yield stage


@pytest.fixture(autouse=True)
def without_gains(stage):
    stage.robot.params_set(**dict.fromkeys(GAINS, 0.0))


def wheel_rad_s(stage):
    stage.robot.drive(SPEED_M_S, 0.0)
    return stage.robot.status().joints["left"].velocity_rad_s


def test_gains_are_listed_with_unit_and_range_and_refused_beyond_it(stage):
    about = stage.robot.params_list()[GAIN]
    assert (about["value"], about["unit"], about["minimum"]) == (0.0, "s/rad", 0)
    with pytest.raises(ClientError, match=r"is out of range \(0 to 1000 s/rad\)"):
        stage.robot.params_set(**{GAIN: -0.1, "limits.linear_m_s": 0.2})
    with pytest.raises(ClientError, match=r"is out of range"):
        stage.robot.params_set(**{GAIN: None})
    with pytest.raises(ClientError, match=rf"did you mean {GAIN}"):
        stage.robot.params_set(**{"joint.left.speed_loop.gain_n_m_s_per_rad": 0.1})
    assert stage.robot.params_get("limits.linear_m_s")["limits.linear_m_s"] != 0.2
    assert stage.robot.params_get(GAIN) == {GAIN: 0.0}


def test_gains_that_are_set_while_it_drives_bring_the_wheel_to_its_speed(stage):
    wanted = SPEED_M_S / RADIUS_M
    stage.robot.arm()
    wait_until(lambda: wheel_rad_s(stage) > 0.5 * wanted, "it drives")
    wait_until(lambda: 0.65 * wanted < wheel_rad_s(stage) < 0.85 * wanted, "too slow")
    assert stage.robot.params_set(**GAINS) == GAINS
    wait_until(lambda: abs(wheel_rad_s(stage) - wanted) < 0.03 * wanted, "the commanded speed")
    stage.robot.drive(0.0, 0.0)
    wait_until(lambda: stage.sim.truth().at_rest, "at rest")
    stage.robot.disarm()


def test_changed_gains_are_saved_in_the_robot_file(stage):
    stage.robot.params_set(**GAINS)
    with at_terminal("params", "save", "--yes", "--socket", stage.socket) as screen:
        assert screen.end() == 0, screen.text
    robot = load_robot(stage.file)
    for joint in robot.joint.values():
        assert (joint.speed_loop.gain_s_per_rad, joint.speed_loop.integral_per_rad) == (0.05, 0.4)
        assert joint.speed_loop.acceleration_s2_per_rad == 0.0
