# SPDX-License-Identifier: Apache-2.0
"""Which bases `motord calibrate` measures."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from motord.cli import cli
from motord.cli.common import Exit
from motord.commission.geometry import free_of
from motord.commission.person import Failed
from motord.config import load_robot

ROBOTS = Path(__file__).resolve().parents[2] / "config/robots"


@pytest.mark.parametrize("name", ["mecanum4", "omni3"])
def test_the_geometry_of_a_base_that_moves_sideways_is_not_fitted(name):
    with pytest.raises(Failed, match="with a tape"):
        free_of(load_robot(ROBOTS / f"{name}.toml"), "all")


def test_a_log_of_such_a_base_changes_nothing(tmp_path):
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


def test_a_differential_base_is_measured_whole():
    assert set(free_of(load_robot(ROBOTS / "demo.toml"), "all")) == {"scale", "ratio", "track"}
