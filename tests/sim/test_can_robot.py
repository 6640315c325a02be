# SPDX-License-Identifier: Apache-2.0
"""A robot on a CAN bus, whole: simulated drives in one process, the daemon in another."""

import re

import pytest

from motord.config import load_robot
from motord.tools.demo import run_demo
from motord_hal.base.paths import config_dir

PATIENT_S = "5.0"
"""For every time-out: a busy machine that stalls the simulator proves nothing."""


@pytest.mark.parametrize(
    ("name", "profile", "line"),
    [
        ("odrive-two", "odrive-0.6", "can0"),
        ("cia402-two", "cia402", "can0"),
        ("cia402-torque", "cia402-torque", "can0"),
    ],
)
def test_a_robot_on_two_drives_drives_its_course_and_stops_clean(tmp_path, name, profile, line):
    drive = (config_dir() / "drives" / f"{profile}.toml").read_text(encoding="utf-8")
    drive = re.sub(r"silence_s = .*", f"silence_s = {PATIENT_S}", drive)
    (tmp_path / "patient.toml").write_text(
        drive.replace(f'name = "{profile}"', 'name = "patient"'), encoding="utf-8"
    )
    text = (config_dir() / "robots" / f"{name}.toml").read_text(encoding="utf-8")
    text = re.sub(r"(\w+_timeout_s) = .*", rf"\1 = {PATIENT_S}", text)
    text = re.sub(r"drive_watchdog_s = .*", f"drive_watchdog_s = {PATIENT_S}", text)
    robot = tmp_path / "robot.toml"
    robot.write_text(
        text.replace(f'drive = "{profile}"', 'drive = "./patient.toml"'), encoding="utf-8"
    )

    report = run_demo(robot, load_robot(robot), 8.0, lambda text: None).to_json()
    assert report["engine"] == {line: "asyncio"}
    assert report["safety"]["final_state"] == "idle"
    assert report["safety"]["faults"] == []
    assert report["clean_exit"]
    assert report["odometry"]["distance_m"] > 1.0
    assert report["odometry"]["distance_error_percent"] < 5.0
