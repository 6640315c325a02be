# SPDX-License-Identifier: Apache-2.0
"""Mecanum and omni bases in the robot file: rows as the textbook has them, and what is refused."""

import math
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.sections.bases import wheel_row

ROBOTS = Path(__file__).resolve().parents[2] / "config/robots"


def problems(tmp_path, name, *changes):
    text = (ROBOTS / f"{name}.toml").read_text("utf-8")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    path = tmp_path / "robot.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(ConfigError) as found:
        load_robot(path)
    return str(found.value)


def test_the_rows_of_mecanum_wheels_are_those_of_taheri_qiao_and_ghaeminezhad():
    robot = load_robot(ROBOTS / "mecanum4.toml")
    rows = [wheel_row(robot.base, joint) for joint in robot.joint.values()]
    lever_m = 0.46 / 2.0 + 0.4 / 2.0
    assert rows == [
        pytest.approx((1.0, -1.0, -lever_m)),
        pytest.approx((1.0, 1.0, lever_m)),
        pytest.approx((1.0, 1.0, -lever_m)),
        pytest.approx((1.0, -1.0, lever_m)),
    ]


def test_the_rows_of_a_lekiwi_are_those_of_its_rolling_directions():
    robot = load_robot(ROBOTS / "lekiwi-base.toml")
    rows = [wheel_row(robot.base, joint) for joint in robot.joint.values()]
    for row, rolling_deg in zip(rows, (150.0, 270.0, 30.0), strict=True):
        rolling_rad = math.radians(rolling_deg)
        expected = (math.cos(rolling_rad), math.sin(rolling_rad), 0.125)
        assert tuple(row) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        (
            "mecanum4",
            [
                ("[limits]", 'rollers = "o"\n\n[limits]'),
                ("wheelbase_m = 0.4", "wheelbase_m = 0.46"),
            ],
            "have to form an X",
        ),
        (
            "mecanum4",
            [('place = "rear-left"', 'place = "front-left"')],
            "one wheel at front-left, not 2",
        ),
        ("mecanum4", [('place = "rear-left"', 'side = "left"')], "a mecanum base does not have it"),
        ("mecanum4", [('place = "rear-left"\n', "")], "place is missing: one of front-left"),
        ("omni3", [("angle_rad = 1.0472\n", "")], "angle_rad is missing (or x_m and y_m)"),
        (
            "omni3",
            [("angle_rad = 1.0472", "angle_rad = 1.0472\nx_m = 0.1\ny_m = 0.1")],
            "given twice",
        ),
        (
            "omni3",
            [
                ("angle_rad = 1.0472", "x_m = 0.0\ny_m = 0.1\nrolling_rad = 0.0"),
                ("angle_rad = 3.1416", "x_m = 0.1\ny_m = 0.2\nrolling_rad = 0.0"),
                ("angle_rad = 5.236", "x_m = 0.0\ny_m = -0.1\nrolling_rad = 0.0"),
            ],
            "do not determine how the base moves",
        ),
        (
            "omni3",
            [
                ("angle_rad = 1.0472", "angle_rad = 1.0472\nrolling_rad = 1.0472"),
                ("angle_rad = 3.1416", "angle_rad = 3.1416\nrolling_rad = 3.1416"),
                ("angle_rad = 5.236", "angle_rad = 5.236\nrolling_rad = 5.236"),
            ],
            "nothing turns this base about",
        ),
        ("demo", [('side = "right"\n', "")], 'side is missing: "left" or "right"'),
        (
            "demo",
            [('side = "right"', 'side = "right"\nplace = "front-left"')],
            "a differential base does not have it",
        ),
    ],
)
def test_wheels_that_cannot_work_are_refused_with_the_reason(tmp_path, name, changes, words):
    found = problems(tmp_path, name, *changes)
    assert words in found
    assert all(row.split(":")[1].isdigit() for row in found.splitlines() if "robot.toml" in row)
