# SPDX-License-Identifier: Apache-2.0
"""A robot on a CAN bus, whole: simulated drives in one process, the daemon in another."""

import re

import pytest

from motord.tools.demo import run_demo
from motord_hal.paths import config_dir

PATIENT_S = "5.0"
"""For every time-out: a busy machine that stalls the simulator proves nothing."""


@pytest.fixture
def robot(tmp_path):
    drive = (config_dir() / "drives" / "odrive-0.6.toml").read_text(encoding="utf-8")
    drive = re.sub(r"silence_s = .*", f"silence_s = {PATIENT_S}", drive)
    (tmp_path / "patient.toml").write_text(
        drive.replace('name = "odrive-0.6"', 'name = "patient"'), encoding="utf-8"
    )
    text = (config_dir() / "robots" / "odrive-two.toml").read_text(encoding="utf-8")
    text = re.sub(r"(\w+_timeout_s) = .*", rf"\1 = {PATIENT_S}", text)
    path = tmp_path / "robot.toml"
    path.write_text(text.replace('"odrive-0.6"', '"./patient.toml"'), encoding="utf-8")
    return path


def test_a_robot_on_two_odrives_drives_its_course_and_stops_clean(robot):
    report = run_demo(robot, "odrive-two", 8.0, lambda text: None).to_json()
    assert report["engine"] == {"can0": "asyncio"}
    assert report["safety"]["final_state"] == "idle"
    assert report["safety"]["faults"] == []
    assert report["clean_exit"]
    assert report["odometry"]["distance_m"] > 1.0
    assert report["odometry"]["distance_error_percent"] < 5.0
