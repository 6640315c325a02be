# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.speed_loop]: rules between it and the drive of its joint."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


def errors(tmp_path, robot, old, new):
    """Return the errors of a shipped robot file in which `old` is replaced by `new`."""
    text = (ROBOTS / f"{robot}.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "robot.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    return [f"{row.key}: {row.text}" for row in caught.value.problems]


TORQUE = 'drive "cia402-torque" takes a torque'
IN_DUTY = "gain_s_per_rad = 0.1\ntorque_max_n_m = 3.0"
IN_N_M = "[joint.left.speed_loop]\nstatic_n_m = 1.0\n\n[joint.left.encoder]"


@pytest.mark.parametrize(
    ("robot", "edit", "key", "message"),
    [
        ("cia402-torque", ("torque_max_n_m = 3.0", IN_DUTY), "gain_s_per_rad",
         f"has the wrong unit: {TORQUE}"),
        ("cia402-torque", ("gain_n_m_s_per_rad = 1.0", "# "), "gain_n_m_s_per_rad",
         f"is missing: {TORQUE}"),
        ("cia402-torque", ("torque_max_n_m = 3.0", "# "), "torque_max_n_m",
         f"is missing: {TORQUE} (N·m at the wheel)"),
        ("pi4-encoders", ("[joint.left.encoder]", IN_N_M), "static_n_m",
         'has the wrong unit: drive "tb6612fng" takes a duty'),
    ],
)  # fmt: skip
def test_a_speed_loop_is_in_the_unit_of_its_drive(tmp_path, robot, edit, key, message):
    assert f"joint.left.speed_loop.{key}: {message}" in errors(tmp_path, robot, *edit)


def test_a_speed_loop_needs_a_measured_speed(tmp_path):
    loop = "[joint.left.speed_loop]\ngain_s_per_rad = 0.1\n\n[joint.right]"
    (row,) = errors(tmp_path, "sabertooth", "[joint.right]", loop)
    assert row.startswith("joint.left.speed_loop: needs a measured speed")
