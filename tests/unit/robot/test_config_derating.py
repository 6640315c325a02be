# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.derating]: pairs are complete, in order, and of a value that the drive reports."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.control.assembly import core_config

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


def problems(tmp_path, lines):
    path = tmp_path / "robot.toml"
    text = DEMO.read_text(encoding="utf-8")
    path.write_text(f"{text}\n[joint.left.derating]\n{lines}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("temperature_from_c = 60", "temperature_to_c: is missing beside temperature_from_c"),
        ("current_to_a = 60", "current_from_a: is missing beside current_to_a"),
        (
            "temperature_from_c = 60\ntemperature_to_c = 60",
            "temperature_to_c: must be above temperature_from_c (60)",
        ),
        ("current_from_a = 9\ncurrent_to_a = 8", "current_to_a: must be above current_from_a (9)"),
        (
            "voltage_from_v = 20\nvoltage_to_v = 22",
            "voltage_to_v: must be below voltage_from_v (20)",
        ),
    ],
)
def test_an_invalid_range_is_refused(tmp_path, lines, message):
    assert f"joint.left.derating.{message}" in problems(tmp_path, lines)


def test_an_unreported_measure_cannot_derate(tmp_path):
    path = tmp_path / "robot.toml"
    text = (DEMO.parent / "pi4-encoders.toml").read_text(encoding="utf-8")
    ours = "[joint.left.derating]\ncurrent_from_a = 8\ncurrent_to_a = 9\n"
    path.write_text(f"{text}\n{ours}", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    (row,) = caught.value.problems
    assert row.text == 'drive "tb6612fng" does not report its current'


def test_the_core_gets_the_ranges_of_each_joint():
    robot = load_robot(
        DEMO, ["joint.left.derating.voltage_from_v=22", "joint.left.derating.voltage_to_v=20"]
    )
    left, right = core_config(robot, robot.profiles)["joint"]
    none = {"full": 0.0, "none": 0.0}
    assert left["derating"]["range"] == [none, none, {"full": 22.0, "none": 20.0}]
    assert right["derating"]["range"] == [none] * 3
