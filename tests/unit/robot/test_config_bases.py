# SPDX-License-Identifier: Apache-2.0
"""Bases in the robot file: rows and modules as in the textbook, and mistakes that are refused."""

import math
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.sections.bases import wheel_modules, wheel_row

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


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
            "no wheel can turn this base",
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


SWERVE = """[robot]
name = "swerve"

[base]
kind = "swerve"
track_m = 0.3
wheelbase_m = 0.4
wheel_radius_m = 0.05

[line.servos]
kind = "feetech"
port = "/dev/ttyACM0"
baudrate = 1000000
cycle_hz = 20
"""


def module(number, where):
    """Return the tables of a wheel on two bus servos."""
    return f"""
[joint.drive{number}]
line = "servos"
drive = "sts3215"
unit = {2 * number}
{where}

[joint.steer{number}]
line = "servos"
drive = "sts3215-position"
unit = {2 * number + 1}
{where}
steers = true
position_min_rad = -1.6
position_max_rad = 1.6
velocity_max_rad_s = 4.0
zero_count = 2048
"""


def written(tmp_path, text):
    path = tmp_path / "robot.toml"
    path.write_text(text, "utf-8")
    return load_robot(path)


def test_the_modules_of_a_car_are_its_places_from_the_middle_of_the_fixed_axle():
    robot = load_robot(ROBOTS / "ackermann-servo.toml")
    assert wheel_modules(robot.base, robot.joint) == [
        (0.0, 0.0, (), ("drive",)),
        (0.32, 0.0, ("steering",), ()),
    ]


def test_a_swerve_has_its_modules_at_corners_or_anywhere(tmp_path):
    places = [f"x_m = {x}\ny_m = {y}" for x, y in ((0.2, 0.0), (-0.1, 0.15), (-0.1, -0.15))]
    text = SWERVE + "".join(module(n, place) for n, place in enumerate(places, 1))
    robot = written(tmp_path, text)
    assert wheel_modules(robot.base, robot.joint) == [
        (0.2, 0.0, ("steer1",), ("drive1",)),
        (-0.1, 0.15, ("steer2",), ("drive2",)),
        (-0.1, -0.15, ("steer3",), ("drive3",)),
    ]
    corners = SWERVE + module(1, 'place = "front-left"') + module(2, 'place = "rear-right"')
    robot = written(tmp_path, corners)
    assert [found[:2] for found in wheel_modules(robot.base, robot.joint)] == [
        (0.2, 0.15), (-0.2, -0.15),
    ]  # fmt: skip


def test_a_tricycle_may_be_driven_and_steered_by_its_one_wheel_behind(tmp_path):
    text = (ROBOTS / "ackermann-servo.toml").read_text("utf-8")
    text = text.replace('kind = "ackermann"', 'kind = "tricycle"\nsteered = "rear"')
    text = text.replace('place = "front"', 'place = "rear"')
    robot = written(tmp_path, text)
    assert wheel_modules(robot.base, robot.joint) == [(-0.32, 0.0, ("steering",), ("drive",))]


CAR = "ackermann-servo"
STEERED_MISTAKES = [
    ([('place = "front"', 'place = "rear"')], "this wheel is on the fixed axle"),
    ([('place = "rear" ', 'place = "front-left" ')], "would be dragged in a curve"),
    ([("steers = true\n", "")], "only a joint that steers has it"),
    ([('drive = "sts3215-position"', 'drive = "sts3215"')], "takes no positions"),
    ([("turning_radius_m = 0.7", "turning_radius_m = 0.3")], "a curve of 0.3 m needs"),
    ([("position_max_rad = 0.5\n", "")], "position_max_rad is missing"),
    ([("velocity_max_rad_s = 4.0 ", "# ")], "velocity_max_rad_s is missing"),
    (
        [("position_min_rad = -0.5", "position_min_rad = 0"), ("max_rad = 0.5", "max_rad = 0")],
        "a range of nothing",
    ),
    ([('kind = "ackermann"', 'kind = "differential"')], "a differential base has no steered"),
]


@pytest.mark.parametrize(("changes", "words"), STEERED_MISTAKES)
def test_steering_that_cannot_work_is_refused(tmp_path, changes, words):
    if "differential" in changes[0][1]:
        changes = [*changes, ("wheelbase_m = 0.32", "#"), ("turning_radius_m = 0.7", "#")]
        changes += [('place = "rear" ', 'side = "left" '), ('place = "front" ', 'side = "right" ')]
    assert words in problems(tmp_path, CAR, *changes)


@pytest.mark.parametrize(
    ("modules", "words"),
    [
        (module(1, 'place = "front"'), "has 2 to 4 modules at different places, not 1"),
        (
            module(1, 'place = "front"') + module(2, 'place = "front"'),
            "joints steer1 and steer2 steer the same wheel",
        ),
        (
            module(1, 'place = "front"')
            + module(2, 'place = "rear"').replace("position_max_rad = 1.6", "position_max_rad = 1"),
            "too small for a swerve module",
        ),
        (
            module(1, 'place = "front"') + module(2, 'place = "rear"').partition("\n[joint.st")[0],
            "no joint steers this wheel",
        ),
    ],
)
def test_a_swerve_that_cannot_work_is_refused(tmp_path, modules, words):
    with pytest.raises(ConfigError, match=words):
        written(tmp_path, SWERVE + modules)


def test_a_joint_that_steers_is_refused_on_the_engine_that_does_not_carry_positions(tmp_path):
    changes = [('drive = "sts3215-position"', 'drive = "sts3215-position"'), ("tries = 6", "")]
    can = ('line = "servos"', 'line = "can0"')
    found = problems(
        tmp_path, CAR, *changes, can, ('interface = "socketcan"', 'interface = "slcan"')
    )
    assert 'joint steering steers: its line needs interface = "socketcan"' in found


@pytest.mark.parametrize("interface", ["slcan", "udp_multicast", "kvaser"])
def test_positions_are_refused_on_an_adapter_that_the_engine_in_c_does_not_reach(
    tmp_path, interface
):
    change = ('interface = "socketcan"', f'interface = "{interface}"')
    assert problems(tmp_path, "swerve4-can", change).count("for the rt engine") == 4


def test_positions_are_carried_by_a_bus_of_sockets(tmp_path):
    text = (ROBOTS / "swerve4-can.toml").read_text("utf-8")
    robot = written(tmp_path, text.replace('interface = "socketcan"', 'interface = "unix"'))
    assert robot.line["can0"].interface == "unix"


def test_a_joint_that_steers_is_refused_behind_a_gateway(tmp_path):
    gateway = 'kind = "rtu-over-tcp"\nhost = "gateway"\n'
    found = problems(
        tmp_path, CAR,
        ('kind = "feetech"\nport = "/dev/ttyACM0"\n', gateway),
        ('drive = "sts3215-position"', 'drive = "cs2rs-position"'),
    )  # fmt: skip
    assert 'joint steering steers: its line needs kind = "modbus-rtu"' in found
