# SPDX-License-Identifier: Apache-2.0
"""The joints that `motord tune` takes, and the reasons why it refuses the others."""

import pytest

from motord.commission.person import Failed
from motord.commission.tune.procedure import tunable
from motord.config import load_robot
from motord_hal.base.paths import config_dir

ROBOTS = config_dir() / "robots"
JOINTS = """
[robot]
name = "conveyor"

[base]
kind = "joints"

[line.can0]
kind = "can"
interface = "socketcan"
channel = "can0"
bitrate = 1000000
cycle_hz = 100

[joint.belt]
line = "can0"
drive = "cia402-torque"
unit = 1
velocity_max_rad_s = 5.0
acceleration_max_rad_s2 = 10.0
speed_loop = { torque_max_n_m = 1.0, gain_n_m_s_per_rad = 1.0 }
"""


def test_a_joint_without_a_base_is_refused_before_anything_moves(tmp_path):
    file = tmp_path / "conveyor.toml"
    file.write_text(JOINTS, encoding="utf-8")
    with pytest.raises(Failed, match="this robot has none: set the gains"):
        tunable(load_robot(file), "belt")


def test_a_wheel_under_a_speed_loop_of_motord_is_taken():
    tunable(load_robot(ROBOTS / "cia402-torque.toml"), "left")


def test_a_wheel_whose_drive_holds_its_speed_is_refused():
    with pytest.raises(Failed, match="holds the speed of the wheel by itself"):
        tunable(load_robot(ROBOTS / "demo.toml"), "left")
