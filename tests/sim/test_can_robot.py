# SPDX-License-Identifier: Apache-2.0
"""A robot on a CAN bus, whole: simulated drives in one process, the daemon in another."""

from pathlib import Path

import pytest

from motord.tools.demo import run_demo
from motord_hal.paths import config_dir


@pytest.mark.parametrize("name", ["odrive-two", "cia402-two"])
def test_a_robot_on_a_can_bus_drives_its_course_and_stops_clean(name):
    robot = Path(config_dir() / "robots" / f"{name}.toml")
    result = run_demo(robot, name, 8.0, lambda text: None)
    report = result.to_json()
    assert report["engine"] == {"can0": "asyncio"}
    assert report["safety"]["final_state"] == "idle"
    assert report["safety"]["faults"] == []
    assert report["clean_exit"]
    assert report["odometry"]["distance_m"] > 1.0
    assert result.score.ok, report["odometry"]
