# SPDX-License-Identifier: Apache-2.0
"""A robot on a microcontroller board drives the course, as `motord demo --robot esp32` does."""

import json
import subprocess
import sys

from tests.sim.daemon_stage import ROOT

ESP32 = (ROOT / "config/robots/esp32.toml").read_text(encoding="utf-8")
PATIENT = "[safety]\nfeedback_timeout_s = 2.0\nheartbeat_timeout_s = 2.0\n"
"""Section with which a delay by a busy machine is no fault."""


def test_a_robot_on_a_board_drives_the_course_with_accurate_odometry(tmp_path):
    path = tmp_path / "esp32.toml"
    text = ESP32.replace("[safety]\n", PATIENT).replace("watchdog_s = 0.25", "watchdog_s = 2.0")
    assert PATIENT in text
    text = text.replace("unit = 1\n", "unit = 1\ntries = 10\n")
    path.write_text(text, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "motord", "demo", "--json", "--seconds", "6", "--robot", path],
        capture_output=True,
        text=True,
        timeout=90,
        cwd=ROOT,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    result = json.loads(run.stdout)
    assert result["ok"] is True
    assert result["engine"] == {"board": "rt"}
    assert result["odometry"]["distance_m"] > 0.5
    assert result["safety"]["final_state"] == "idle"
