# SPDX-License-Identifier: Apache-2.0
"""Wheels of one base that are usually alike: what stands on one side only is refused."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
ONE_SIDED = [
    ("demo", "left", "gear_ratio = 20.0"),
    ("demo", "left", "counts_per_turn = 1024"),
    ("demo", "right", "wheel_radius_m = 0.2"),
    ("mecanum4", "rear_right", "gear_ratio = 2.0"),
    ("swerve4-can", "", "gear_ratio = 2.0"),
]


def loaded(tmp_path, name, *additions):
    """Load a shipped robot with lines added to its joints. An empty joint: the last one."""
    text = (ROBOTS / f"{name}.toml").read_text("utf-8")
    for joint, line in additions:
        joint = joint or list(load_robot(ROBOTS / f"{name}.toml").joint)[-1]
        header = f"[joint.{joint}]\n"
        assert header in text
        key = line.partition(" ")[0]
        before, after = text.split(header, 1)
        own, *others = after.split("\n\n", 1)
        kept = [row for row in own.splitlines() if not row.startswith(f"{key} ")]
        text = before + header + "\n\n".join(["\n".join([line, *kept]), *others])
    path = tmp_path / "robot.toml"
    path.write_text(text, "utf-8")
    return load_robot(path)


@pytest.mark.parametrize(("name", "joint", "line"), ONE_SIDED)
def test_a_key_on_one_side_only_is_refused_with_both_values_and_both_joints(
    tmp_path, name, joint, line
):
    with pytest.raises(ConfigError) as found:
        loaded(tmp_path, name, (joint, line))
    key, _, value = line.partition(" = ")
    words = str(found.value)
    assert f'add differs_in = ["{key}"]' in words
    assert f"{float(value):g}" in words


@pytest.mark.parametrize(("name", "joint", "line"), ONE_SIDED)
def test_a_difference_that_is_meant_passes(tmp_path, name, joint, line):
    key = line.partition(" ")[0]
    loaded(tmp_path, name, (joint, line), (joint, f'differs_in = ["{key}"]'))


def test_radii_of_a_calibration_differ_a_little(tmp_path):
    radius_m = load_robot(ROBOTS / "demo.toml").base.wheel_radius_m
    loaded(tmp_path, "demo", ("left", f"wheel_radius_m = {radius_m * 1.05:.5f}"))


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_no_shipped_robot_has_a_difference(path):
    assert not any(joint.differs_in for joint in load_robot(path).joint.values())
