# SPDX-License-Identifier: Apache-2.0
"""Mistakes that people make in a robot file, and the sentence of the error that helps."""

import pytest

from motord.config import ConfigError, load_robot
from motord_hal.base.paths import config_dir

DEMO = (config_dir() / "robots/demo.toml").read_text(encoding="utf-8")


def rows_of(tmp_path, right, wrong):
    assert right in DEMO
    path = tmp_path / "robot.toml"
    path.write_text(DEMO.replace(right, wrong, 1), encoding="utf-8")
    try:
        found = load_robot(path).warnings
    except ConfigError as error:
        found = error.problems
    return [str(row).removeprefix(f"{path}:") for row in found]


@pytest.mark.parametrize(
    ("wrong", "cure"),
    [
        ("track_m = 0,45", "11: syntax: column 12: "),
        ("track_m = 0,45", "a decimal number is written with a point, 0.45"),
        ("track_m: 0.45", "a key and its value are joined by =, not by :"),
        ("track_m = 0.45 m", "a number has no unit behind it: the unit is in the key's name"),
        ("track_m =", "there is no value behind ="),
        ("track_m = True", "write true in small letters"),
        ("track_m = wide", 'a string stands in quotes, "wide"'),
        ('track_m = "wide', "a string has no closing quote"),
        ("[joint.left", "a table's name ends with ]"),
        ("track_m = [1,", "is not closed"),
        ("track_m = 1\ntrack_m = 2", "12: syntax: key track_m is there twice, in lines 11 and 12"),
        ("track_m = 0.45\n[base]", "12: syntax: table [base] is there twice, in lines 9 and 12"),
    ],
)  # fmt: skip
def test_a_text_that_is_not_toml_is_explained_with_its_likely_cause(tmp_path, wrong, cure):
    (row,) = rows_of(tmp_path, "track_m = 0.45", wrong)
    assert cure in row


@pytest.mark.parametrize(
    ("right", "wrong", "cure"),
    [
        ("wheel_radius_m = 0.0825", "wheel_diameter_m = 0.165",
         "wheel_radius_m: halve it, wheel_radius_m = 0.0825"),
        ("wheel_radius_m = 0.0825", "wheel_radius_mm = 82.5",
         "wheel_radius_m: multiply by 0.001, wheel_radius_m = 0.0825"),
        ("wheel_radius_m = 0.0825", "wheel_diameter_cm = 16.5",
         "wheel_radius_m: multiply by 0.005, wheel_radius_m = 0.0825"),
        ("velocity_max_rad_s = 15.0", "velocity_max_rpm = 150",
         "velocity_max_rad_s: multiply by 0.1047, velocity_max_rad_s = 15.71"),
        ("command_timeout_s = 0.3", "command_timeout_ms = 300",
         "command_timeout_s: multiply by 0.001, command_timeout_s = 0.3"),
        ("velocity_max_rad_s = 15.0", "velocity_max = 15.0",
         "did you mean velocity_max_rad_s, in rad/s?"),
    ],
)  # fmt: skip
def test_a_key_in_another_unit_is_converted_and_not_just_renamed(tmp_path, right, wrong, cure):
    (row,) = rows_of(tmp_path, right, wrong)
    assert cure in row


@pytest.mark.parametrize(
    ("right", "wrong", "cure"),
    [
        ('"modbus-rtu"', '"modbus"', 'did you mean "modbus-rtu" or "modbus-tcp"?'),
        ('name = "demo"', "name = 12", '12 is not a string: write "12"'),
        ("track_m = 0.45", 'track_m = "0,45"', "is not a number: write 0.45, without quotes"),
        ("wheel_radius_m = 0.0825", "wheel_radius_m = 0.85", "a wheel of 1.7 m across"),
        ("track_m = 0.45", "track_m = 0.03", "3 cm between left and right wheels"),
        ('parity = "odd"\n', 'parity = "odd"\n', 'else write baudrate = 115200, parity = "none"'),
    ],
)
def test_a_value_that_is_wrong_or_unlikely_is_questioned(tmp_path, monkeypatch, right, wrong, cure):
    odd = DEMO.replace('engine = "auto"\n', 'engine = "auto"\nparity = "odd"\n')
    monkeypatch.setitem(globals(), "DEMO", odd if "parity" in right else DEMO)
    assert any(cure in row for row in rows_of(tmp_path, right, wrong))


def test_a_key_with_a_line_break_in_it_is_reported_in_one_line(tmp_path):
    (row,) = rows_of(tmp_path, "track_m = 0.45", 'track_m = 0.45\n"a\\nb" = 1')
    assert "\n" not in row
    assert "unknown key" in row
