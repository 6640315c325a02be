# SPDX-License-Identifier: Apache-2.0
"""A robot on a CAN bus, whole: simulated drives in one process, the daemon in another."""

from pathlib import Path

from motord.tools.demo import run_demo
from motord_hal.paths import config_dir


def test_a_robot_on_two_odrives_drives_its_course_and_stops_clean():
    robot = Path(config_dir() / "robots" / "odrive-two.toml")
    result = run_demo(robot, "odrive-two", 8.0, lambda text: None)
    report = result.to_json()
    assert report["engine"] == {"can0": "asyncio"}
    assert report["safety"]["final_state"] == "idle"
    assert report["safety"]["faults"] == []
    assert report["clean_exit"]
    assert report["odometry"]["distance_m"] > 1.0
    assert result.score.ok, report["odometry"]
