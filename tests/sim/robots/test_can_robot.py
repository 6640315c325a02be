# SPDX-License-Identifier: Apache-2.0
"""A robot on a CAN bus: simulated drives in one process, the daemon in another."""

import pytest
from tests.sim.daemon_stage import patient_on_can

from motord.config import load_robot
from motord.tools.demo import run_demo


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "profile", "line"),
    [
        ("odrive-two", "odrive-0.6", "can0"),
        ("cia402-two", "cia402", "can0"),
        ("cia402-torque", "cia402-torque", "can0"),
    ],
)
def test_a_can_robot_drives_its_course_and_stops_cleanly(tmp_path, name, profile, line):
    robot = patient_on_can(tmp_path, name, profile)
    report = run_demo(robot, load_robot(robot), 8.0, lambda text: None).to_json()
    assert report["engine"] == {line: "asyncio"}
    assert report["safety"]["final_state"] == "idle"
    assert report["safety"]["faults"] == []
    assert report["clean_exit"]
    assert report["odometry"]["distance_m"] > 1.0
    assert report["odometry"]["distance_error_percent"] < 5.0


@pytest.mark.long
def test_two_kinds_of_drives_with_one_number_share_a_bus(tmp_path):
    """An ODrive and a VESC may both be number 1: their identifiers have 11 and 29 bits."""
    file = patient_on_can(tmp_path, "odrive-two", "odrive-0.6")
    text = file.read_text("utf-8")
    right = text.index("[joint.right]")
    vesc = text[right:].replace('"./patient.toml"', '"vesc"').replace("unit = 2", "unit = 1")
    file.write_text(text[:right] + vesc, encoding="utf-8")
    report = run_demo(file, load_robot(file), 8.0, lambda text: None).to_json()
    assert report["safety"]["final_state"] == "idle"
    assert report["safety"]["faults"] == []
    assert report["odometry"]["distance_error_percent"] < 5.0
