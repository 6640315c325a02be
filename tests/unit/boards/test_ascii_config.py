# SPDX-License-Identifier: Apache-2.0
"""Boards that read text, in a robot file."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot

TEXT = (Path(__file__).resolve().parents[3] / "config/robots/arduino-text.toml").read_text("utf-8")
TEMPLATE = r'template = "{left:d},{right:d}\n"'


@pytest.mark.parametrize(
    ("right", "wrong", "row"),
    [
        (TEMPLATE, r'template = "{left:d}\n"', "line.board.template: it must contain left, right"),
        (TEMPLATE, r'template = "{left},{mid}\n"', "line.board.template: {mid} is unknown"),
        ("{left_count},", "{left_counts},", "line.board.feedback: {left_counts} is unknown"),
        (
            "{left_count},",
            "",
            "joint.left.counts_per_turn: is not used: the line's feedback has no",
        ),
        (
            "counts_per_turn = 1320\n",
            "",
            "joint.left.counts_per_turn: is missing: the board reports",
        ),
        ("scale = 255.0", "scale = 0", "line.board.scale: 0 is out of range"),
        (
            TEMPLATE,
            'engine = "rt"\n' + r'template = "{left:5},{right:5}\n"',
            'line.board.template: the format "5" of {left} has no letter d, f or g',
        ),
        (
            ",{right_count}",
            'e{right_count}"\nengine = "rt" #',
            'line.board.template: "e" may go on with the number before it: put a space',
        ),
    ],
)
def test_what_does_not_fit_is_reported(tmp_path, right, wrong, row):
    path = tmp_path / "robot.toml"
    assert right in TEXT
    path.write_text(TEXT.replace(right, wrong, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    found = [f"{problem.key}: {problem.text}" for problem in caught.value.problems]
    assert any(problem.startswith(row) for problem in found), found


def test_a_twist_needs_both_sides_on_the_line(tmp_path):
    path = tmp_path / "robot.toml"
    text = TEXT.replace(TEMPLATE, r'template = "{v} {w}\n"').replace(
        '[joint.right]\nline = "board"', '[joint.right]\nline = "other"'
    )
    more = text[text.index("[line.board]") : text.index("[joint.left]")]
    more = more.replace("line.board", "line.other").replace("USB0", "USB1")
    path.write_text(text + more, encoding="utf-8")
    with pytest.raises(ConfigError, match="v and w need a left and a right"):
        load_robot(path)


def test_an_unsupported_format_is_named_with_a_supported_one(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(TEXT.replace(TEMPLATE, r'template = "{left:5},{right:5}\n"'), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"has no letter d, f or g: write \{left:d\}"):
        load_robot(path)


@pytest.mark.parametrize(
    ("feedback", "source"),
    [
        ("", "the wheel's set-point"),
        ('feedback = "{left_rad_s},{right_rad_s}\\n"', "the measured speed"),
        ('feedback = "{left_m_s},{right_m_s}\\n"', "the measured speed"),
        ('feedback = "{voltage_v}\\n"', "the wheel's set-point"),
    ],
)
def test_without_counts_the_check_names_the_source_of_odometry(tmp_path, feedback, source):
    path = tmp_path / "robot.toml"
    text = TEXT.replace("counts_per_turn = 1320\n", "")
    path.write_text(
        text.replace(r'feedback = "{left_count},{right_count}\n"', feedback), encoding="utf-8"
    )
    found = [problem.text for problem in load_robot(path).warnings]
    assert f"without a position counter: odometry comes from {source}, and is less exact" in found
