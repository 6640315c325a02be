# SPDX-License-Identifier: Apache-2.0
"""The description that a page gets: the places of the wheels, for every kind of base."""

import math
from pathlib import Path

import pytest

from motord.bus.web.description import description
from motord.config import load_robot
from motord.config.sections.bases import wheel_modules

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


@pytest.mark.parametrize("file", sorted(ROBOTS.glob("*.toml")), ids=lambda file: file.stem)
def test_every_joint_of_a_base_has_its_wheel_in_the_drawing(file):
    robot = load_robot(file)
    wheels = description(robot)["wheels"]
    if robot.base.kind == "joints":
        assert wheels == []
        return
    modules = wheel_modules(robot.base, robot.joint)
    named = [(module.traction or module.steering)[0] for module in modules] or list(robot.joint)
    assert sorted(wheel["joint"] for wheel in wheels) == sorted(named)
    assert len({(wheel["x_m"], wheel["y_m"]) for wheel in wheels}) == len(wheels)


@pytest.mark.parametrize(("rollers", "sign"), [("x", 1.0), ("o", -1.0)])
def test_upper_rollers_of_mecanum_wheels_point_to_the_middle_in_an_x(rollers, sign):
    robot = load_robot(
        ROBOTS / "mecanum4.toml", [f"base.rollers={rollers}", "base.wheelbase_m=1.5"]
    )
    for wheel in description(robot)["wheels"]:
        towards = math.atan(wheel["y_m"] / wheel["x_m"])
        assert wheel["roller_rad"] == pytest.approx(sign * math.copysign(math.pi / 4, towards))


@pytest.mark.parametrize(
    ("file", "steered"),
    [
        ("ackermann-servo", {"drive": None, "steering": "steering"}),
        ("swerve4-servos", {
            f"{end}_{side}": f"{end}_{side}_steering"
            for end in ("front", "rear") for side in ("left", "right")
        }),
        ("demo", {"left": None, "right": None}),
    ],
)  # fmt: skip
def test_a_wheel_names_the_joint_that_steers_it(file, steered):
    wheels = description(load_robot(ROBOTS / f"{file}.toml"))["wheels"]
    assert {wheel["joint"]: wheel["steered_by"] for wheel in wheels} == steered
