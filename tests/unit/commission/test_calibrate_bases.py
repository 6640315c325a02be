# SPDX-License-Identifier: Apache-2.0
"""The bases that `motord calibrate` can measure."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from motord.api.geometry_fit import Measure, Pose, fit
from motord.cli import cli
from motord.cli.common import Exit
from motord.commission.calibrate.geometry import changes, free_of, words
from motord.commission.person import Failed
from motord.config import load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


@pytest.mark.parametrize("name", ["mecanum4", "omni3", "ackermann-servo", "swerve4-servos"])
@pytest.mark.parametrize("what", ["all", "rotate", "square", "log"])
def test_a_base_without_two_sides_gets_only_its_radius_fitted(name, what):
    robot = load_robot(ROBOTS / f"{name}.toml")
    with pytest.raises(Failed, match="with a tape"):
        free_of(robot, what)
    assert free_of(robot, "straight") == ("scale",)


def test_a_robot_that_does_not_drive_is_refused():
    with pytest.raises(Failed, match="no base that drives"):
        free_of(load_robot(ROBOTS / "pan-tilt.toml"), "straight")


def test_a_wheel_with_its_own_radius_is_scaled_too():
    text = (ROBOTS / "ackermann-servo.toml").read_text("utf-8")
    text = text.replace('place = "rear"', 'place = "rear"\nwheel_radius_m = 0.05')
    robot = load_robot(ROBOTS / "ackermann-servo.toml", text=text)
    path_m = np.linspace(0.0, 2.0, 50)
    measure = Measure("straight", path_m, path_m, Pose(2.06), Pose(0.002))
    found = fit([measure], robot.base.effective_track_m, ("scale",))
    assert changes(robot, found, ("scale",)) == {
        ("base", "wheel_radius_m"): pytest.approx(1.03 * 0.055),
        ("joint", "drive", "wheel_radius_m"): pytest.approx(1.03 * 0.05),
    }
    assert "+3.00 %" in next(words(robot, found, [measure]))


def test_a_log_of_a_mecanum_base_changes_nothing(tmp_path):
    text = (ROBOTS / "mecanum4.toml").read_text("utf-8")
    file, log = tmp_path / "robot.toml", tmp_path / "capture.csv"
    file.write_text(text, "utf-8")
    log.write_text("", "utf-8")
    ran = CliRunner().invoke(
        cli, ["calibrate", "--from", str(log), "--file", str(file), "--yes", "--json"]
    )
    assert ran.exit_code == Exit.FAILED
    assert "mecanum" in ran.stdout
    assert file.read_text("utf-8") == text


def test_a_differential_base_is_fitted_completely():
    assert set(free_of(load_robot(ROBOTS / "demo.toml"), "all")) == {"scale", "ratio", "track"}
