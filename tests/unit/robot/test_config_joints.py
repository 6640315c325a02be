# SPDX-License-Identifier: Apache-2.0
"""Robot files without a base: those that work, and mistakes that are refused with their line."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.understood import understood
from motord.config.wiring import line_specs
from motord.control.assembly import core_config
from motord.control.joint_names import JointNames
from motord.local_socket.server import Refused
from motord.realtime import loop as rt

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
PAN_TILT = (ROBOTS / "pan-tilt.toml").read_text("utf-8")
BELT = """
[line.bus]
kind = "feetech"
port = "/dev/ttyACM1"
baudrate = 1000000
cycle_hz = 100

[joint.belt]
line = "bus"
drive = "sts3215"
unit = 7
velocity_max_rad_s = 4.0
deceleration_max_rad_s2 = 8.0
"""


@pytest.fixture
def loaded(tmp_path):
    def load(text):
        path = tmp_path / "robot.toml"
        path.write_text(text, "utf-8")
        return load_robot(path)

    return load


@pytest.fixture
def problems(loaded):
    def found(before, after, text=PAN_TILT):
        assert before in text
        with pytest.raises(ConfigError) as error:
            loaded(text.replace(before, after, 1))
        return str(error.value)

    return found


def test_each_joint_has_limits_of_its_own_and_the_core_takes_them(loaded):
    robot = loaded(PAN_TILT + BELT)
    config = core_config(robot, robot.profiles)
    assert config["independent"] == 1
    pan, tilt, belt = config["joint"]
    assert pan["position"]["position_max_rad"] == 1.5
    assert tilt["position"]["velocity_rad_s"] == 2.0
    assert belt["position"] == {"used": 0}
    assert (belt["own"]["acceleration_u_s2"], belt["own"]["deceleration_u_s2"]) == (20.0, 8.0)
    rt.raw_config(config)


def test_a_single_joint_is_a_robot(loaded):
    robot = loaded(PAN_TILT.partition("[joint.tilt]")[0])
    rt.raw_config(core_config(robot, robot.profiles))
    assert [joint.takes for joint in understood(robot).joints] == ["position"]


def test_the_time_of_a_stop_includes_the_rise_of_the_deceleration(loaded):
    *_, belt = understood(loaded(PAN_TILT + BELT + "jerk_max_rad_s3 = 16.0\n")).joints
    assert belt.stop_time_s == pytest.approx(4.0 / 8.0 + 8.0 / 16.0)


REFUSED = {
    "velocity_max_rad_s = 2.0": ("", "velocity_max_rad_s is missing: how fast"),
    "position_min_rad = -1.5 ": ("# ", "position_min_rad is missing: how far"),
    "unit = 1\n": ('unit = 1\nside = "left"\n', "joint.pan.side: a joint without a base"),
    "unit = 1 \n": ("", ""),
    'kind = "joints"': (
        'kind = "joints"\n[limits]\nlinear_m_s = 1.0',
        "limits.linear_m_s: there is",
    ),
    "zero_count = 2048": ("wheel_radius_m = 0.1", "joint.pan.wheel_radius_m: a joint without"),
    "acceleration_max_rad_s2 = 10.0": (
        "acceleration_max_rad_s2 = 10.0\njerk_max_rad_s3 = 5.0",
        'joint.pan.jerk_max_rad_s3: drive "sts3215-position" takes positions',
    ),
    "cycle_hz = 100": ('cycle_hz = 100\nengine = "asyncio"', "line.servos.engine: "),
    'drive = "sts3215-position"': (
        'drive = "sts3215"',
        'joint.pan.position_min_rad: drive "sts3215" takes velocities',
    ),
}


@pytest.mark.parametrize("before", [text for text in REFUSED if text in PAN_TILT])
def test_what_cannot_work_is_refused_with_its_reason(problems, before):
    after, reason = REFUSED[before]
    assert reason in problems(before, after)


def test_a_stop_that_takes_too_long_is_refused(problems):
    text = problems(
        "deceleration_max_rad_s2 = 8.0", "deceleration_max_rad_s2 = 0.1", PAN_TILT + BELT
    )
    assert "joint.belt.deceleration_max_rad_s2: from full speed it takes 40 s to rest" in text


def test_a_base_has_no_limits_of_single_joints(problems):
    text = (ROBOTS / "two-bus-servos.toml").read_text("utf-8")
    found = problems("unit = 7", "unit = 7\njerk_max_rad_s3 = 5.0", text)
    assert "joint.left.jerk_max_rad_s3: only a joint without a base has it" in found


def test_joint_names_become_places_and_unknown_ones_are_refused(loaded):
    names = JointNames(loaded(PAN_TILT + BELT))
    assert names.places({"belt": 2.0}, {"tilt": 0.5}) == ({2: 2.0}, {1: 0.5})
    for wanted, why in (
        (({"belt": 1.0}, {"roll": 1.0}), "there is no joint 'roll'; there are: pan, tilt, belt"),
        (({"pan": 1.0}, {}), "joint pan takes positions"),
        (({}, {"belt": 1.0}), "joint belt takes velocities"),
    ):
        with pytest.raises(Refused, match=why):
            names.places(*wanted)
    wheels = JointNames(load_robot(ROBOTS / "demo.toml"))
    with pytest.raises(Refused, match="motord drive"):
        wheels.places({"left": 1.0}, {})


def test_a_servo_beyond_the_range_of_its_pulses_is_refused(problems):
    text = (ROBOTS / "ackermann-servo-pwm.toml").read_text("utf-8")
    found = problems("position_max_rad = 0.5", "position_max_rad = 0.9", text)
    assert "joint.steering.position_max_rad: the servo's pulses reach 0.785 rad" in found


def with_pan(**keys):
    """Return the robot file with these keys of its pan joint, an STS3215."""
    rows, here = [], False
    for row in PAN_TILT.splitlines():
        here = row == "[joint.pan]" if row.startswith("[") else here
        if not (here and row.partition(" ")[0] in keys):
            rows.append(row)
        if row == "[joint.pan]":
            rows += [f"{key} = {value}" for key, value in keys.items()]
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"zero_count": 4095, "position_min_rad": -2.84, "position_max_rad": 2.84},
            "which goes from 0 to 4095: with this zero_count the joint reaches -6.28 to 0 rad",
        ),
        ({"zero_count": 5000}, "5000 is no position of its drive, which counts 12 bits (to 4095)"),
        ({"velocity_max_rad_s": 30.0}, "30 rad/s is more than drive"),
        (
            {"zero_count": 2048, "position_max_rad": 3.2, "inverted": "true"},
            "with this zero_count the joint reaches -3.14 to 3.14 rad",
        ),
    ],
)
def test_what_a_joint_cannot_reach_is_refused_with_what_it_can(problems, keys, words):
    assert words in problems("", "", with_pan(**keys))


def test_a_whole_turn_of_a_servo_is_a_range(loaded):
    loaded(with_pan(zero_count=2048, position_min_rad=-3.1416, position_max_rad=3.14))


def test_counts_of_the_joint_make_its_set_point(loaded):
    """Not those of its profile: a servo behind a belt counts otherwise."""
    text = with_pan(counts_per_turn=2048, zero_count=1000)
    for before, after in (("sts3215", "xl430"), ("feetech", "dynamixel")):
        text = text.replace(before, after)
    robot = loaded(text)
    (spec,) = line_specs(robot, robot.profiles)
    assert [joint.counts_per_turn for joint in spec.joints] == [2048, 4096]
