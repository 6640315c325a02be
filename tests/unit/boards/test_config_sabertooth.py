# SPDX-License-Identifier: Apache-2.0
"""Sabertooths on one wire, in a robot file."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.rules.wiring.wire import cycle_limit_hz
from motord.config.wiring import line_specs

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
FOUR = (ROBOTS / "sabertooth4.toml").read_text(encoding="utf-8")


def errors(folder, old, new):
    assert old in FOUR
    path = folder / "robot.toml"
    path.write_text(FOUR.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


def test_an_address_outside_128_to_135_is_refused(tmp_path):
    text = "136 is not an address of a Sabertooth (128 to 135)"
    assert errors(tmp_path, "unit = 129", "unit = 136") == [f"joint.rear_left.unit: {text}"]


def test_sabertooths_of_two_profiles_on_one_wire_are_refused(tmp_path):
    profile = (ROBOTS.parent / "drives/sabertooth.toml").read_text(encoding="utf-8")
    other = profile.replace('name = "sabertooth"', 'name = "other"')
    (tmp_path / "other.toml").write_text(other, encoding="utf-8")
    rear = 'drive = "sabertooth"\nunit = 129'
    text = 'joint front_left on the same wire has "sabertooth": all Sabertooths take one'
    found = errors(tmp_path, rear, rear.replace("sabertooth", "./other.toml"))
    assert f"joint.rear_left.drive: {text}" in found


def test_two_sabertooths_on_a_wire_halve_its_cycle_rate():
    robots = (load_robot(ROBOTS / f"{name}.toml") for name in ("sabertooth", "sabertooth4"))
    (alone,), (two,) = (line_specs(robot, robot.profiles) for robot in robots)
    assert 2 * cycle_limit_hz(two) == pytest.approx(cycle_limit_hz(alone))
