# SPDX-License-Identifier: Apache-2.0
"""`motord-bus` started by hand prints why it cannot work."""

import subprocess
import sys
from pathlib import Path

from tests.fork_server import started_from_nothing

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


def bus(*words):
    command = [sys.executable, "-m", "motord.bus", *words]
    with started_from_nothing():
        return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_a_robot_file_that_cannot_be_used_is_reported_as_motord_check_reports_it(tmp_path):
    done = bus(str(tmp_path / "none.toml"))
    assert done.returncode == 2
    assert "none.toml: cannot be read" in done.stderr


def test_without_a_daemon_motord_bus_reports_which_robot_does_not_run():
    done = bus(str(DEMO), "--set", "robot.name=not-running")
    assert done.returncode == 1
    assert "no robot not-running runs here" in done.stderr


def test_motord_bus_has_help_with_an_example():
    done = bus("--help")
    assert done.returncode == 0
    assert "Example: motord-bus robot.toml" in done.stdout
