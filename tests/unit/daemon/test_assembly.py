# SPDX-License-Identifier: Apache-2.0
"""From the robot file to the core's and the lines' configuration: units, signs, order."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config import Limits, load_robot
from motord.config.schema import robot_schema
from motord.control.assembly import base_limits, core_config, line_specs, loop_settings
from motord.realtime import loop as rt
from motord.realtime.loop import SpeedLoopKind

DEFINITIONS = robot_schema()["$defs"]
DIFFERS = 'joint.left.differs_in=["counts_per_turn", "wheel_radius_m"]'
ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


def assembled(name, *overrides):
    robot = load_robot(ROBOTS / f"{name}.toml", overrides)
    profiles = robot.profiles
    return robot, profiles, core_config(robot, profiles)


@pytest.mark.parametrize("path", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_core_takes_every_shipped_robot(path):
    robot, _, config = assembled(path.stem)
    rt.Loop(config, loop_settings(robot))


@pytest.mark.parametrize("gear", [1.0, 20.0])
def test_a_count_is_an_angle_of_the_wheel_and_its_sign_is_the_robots_forward(gear):
    overrides = [f"joint.{side}.gear_ratio={gear}" for side in ("left", "right")]
    _, profiles, config = assembled("demo", *overrides)
    counts = profiles["zlac8015d"].counts_per_turn
    left, right = config["joint"]
    assert counts * gear * left["rad_per_count"] == pytest.approx(2 * math.pi, rel=1e-15)
    assert right["rad_per_count"] == -left["rad_per_count"]  # the right joint is inverted


def test_a_joints_own_encoder_and_radius_outrank_the_profile_and_the_base():
    overrides = ["joint.left.counts_per_turn=1000", "joint.left.wheel_radius_m=0.08", DIFFERS]
    _, _, config = assembled("demo", *overrides)
    left, right = config["joint"]
    assert left["rad_per_count"] == pytest.approx(2 * math.pi / 1000, rel=1e-15)
    assert (left["wheel_radius_m"], right["wheel_radius_m"]) == (0.08, 0.0825)


def test_an_encoder_that_is_not_there_leaves_no_counter():
    _, _, config = assembled("demo", "joint.left.counts_per_turn=0")
    assert [joint["counter_bits"] for joint in config["joint"]] == [0, 32]


def test_a_skid_base_turns_as_if_its_track_were_wider():
    robot, _, config = assembled("skid4")
    levers_m = [joint["row"]["lever_m"] for joint in config["joint"]]
    assert levers_m == [sign * robot.base.track_m * 1.5 / 2.0 for sign in (-1.0, 1.0, -1.0, 1.0)]


def test_a_wheel_that_cannot_reverse_never_gets_a_negative_set_point():
    _, _, config = assembled("forward-only")
    for joint in config["joint"]:
        assert joint["velocity_min_rad_s"] == 0.0
        assert joint["pwm"]["duty_min"] == 0.0
        assert joint["pwm"]["full_duty_rad_s"] == 18.0
    _, _, sent = assembled("demo", "joint.left.reversible=false")
    assert [joint["velocity_min_rad_s"] for joint in sent["joint"]] == [0.0, -15.0]


def test_a_torque_drive_has_a_speed_loop_and_other_drives_do_not():
    _, _, config = assembled("cia402-torque")
    for joint in config["joint"]:
        loop = joint["speed_loop"]
        assert {name for name, value in loop["gains"].items() if value} == {
            "gain_u_s_per_rad",
            "integral_u_per_rad",
        }
        assert (loop["output_min_u"], loop["output_max_u"], loop["correction_max_u"]) == (-3, 3, 3)
        assert loop["kind"] == SpeedLoopKind.TORQUE
    _, _, demo = assembled("demo")
    assert {joint["speed_loop"]["kind"] for joint in demo["joint"]} == {SpeedLoopKind.NONE}


def test_a_duty_drive_with_an_encoder_has_only_feed_forward_by_default():
    _, _, config = assembled("pi4-encoders")
    for joint in config["joint"]:
        loop = joint["speed_loop"]
        assert loop["kind"] == SpeedLoopKind.DUTY
        assert (loop["output_min_u"], loop["output_max_u"], loop["correction_max_u"]) == (
            -1,
            1,
            0.3,
        )
        gains = {name: value for name, value in loop["gains"].items() if value}
        assert gains == {"static_u": 0.05, "viscous_u_s_per_rad": pytest.approx(0.95 / 18.0)}
        assert joint["plausible"]["following_s"] == 0.0
    _, _, blind = assembled("sabertooth")
    assert {joint["speed_loop"]["kind"] for joint in blind["joint"]} == {SpeedLoopKind.NONE}


def test_a_duty_with_gains_is_checked_as_a_drive_that_holds_its_speed():
    _, _, config = assembled("pi4-encoders", "joint.left.speed_loop.gain_s_per_rad=0.02")
    left, right = config["joint"]
    assert left["speed_loop"]["gains"]["gain_u_s_per_rad"] == 0.02
    assert left["plausible"]["following_s"] == 1.0
    assert left["plausible"]["beyond_rad_s"] < right["plausible"]["beyond_rad_s"]


def test_thresholds_of_feedback_are_parts_of_the_wheel_speed_at_the_limits():
    overrides = ["limits.linear_m_s=0.33", "limits.angular_rad_s=0.001"]
    _, _, config = assembled("demo", *overrides, "safety.feedback.following_part=0.5")
    checks = config["joint"][0]["plausible"]
    assert checks["setpoint_min_rad_s"] == pytest.approx(0.4, rel=1e-2)
    assert checks["short_rad_s"] == pytest.approx(2.0, rel=0.03)
    assert (checks["direction_s"], checks["stall_s"], checks["runaway_s"]) == (0.5, 1.0, 0.5)


def test_a_check_of_the_feedback_that_is_switched_off_is_off_in_the_core():
    names = ("direction", "stall", "following", "runaway", "implausible")
    overrides = [f"safety.feedback.{name}_s=0" for name in names]
    _, _, config = assembled("demo", *overrides, "safety.feedback.jumps_max=0")
    checks = config["joint"][1]["plausible"]
    times = [checks[f"{name}_s"] for name in ("direction", "stall", "following", "runaway")]
    assert [*times, checks["apart_s"], checks["jumps_max"]] == [0] * 6


def test_a_duty_holds_no_speed_so_its_check_is_loose_unless_the_file_tightens_it():
    _, _, config = assembled("pi4-encoders")
    checks = config["joint"][0]["plausible"]
    assert checks["following_s"] == 0
    assert checks["setpoint_min_rad_s"] == pytest.approx(0.4 * 18.0)
    assert checks["beyond_rad_s"] > 14.0
    keys = ["following_s=2", "setpoint_min_part=0.2", "runaway_part=0.5"]
    _, _, config = assembled("pi4-encoders", *(f"safety.feedback.{one}" for one in keys))
    checks = config["joint"][0]["plausible"]
    assert checks["following_s"] == 2
    assert checks["setpoint_min_rad_s"] < 4.0
    assert checks["beyond_rad_s"] < 9.5


def test_a_coarse_encoder_widens_the_thresholds_of_feedback():
    wheels = [f"joint.{side}.counts_per_turn=4" for side in ("left", "right")]
    _, _, fine = assembled("esp32")
    _, _, coarse = assembled("esp32", *wheels)
    for name in ("setpoint_min_rad_s", "short_rad_s", "beyond_rad_s", "apart_rad_s"):
        assert coarse["joint"][0]["plausible"][name] > 2 * fine["joint"][0]["plausible"][name]


def test_a_speed_limit_that_is_not_given_is_what_the_drive_can_do_at_the_wheel():
    robot = load_robot(ROBOTS / "two-single-drives.toml")
    left = robot.joint["left"].model_copy(update={"velocity_max_rad_s": None})
    robot = robot.model_copy(update={"joint": {**robot.joint, "left": left}})
    config = core_config(robot, robot.profiles)
    drive_rad_s = 4000 * 2 * math.pi / 60  # the profile's 4000 rpm
    assert config["joint"][0]["velocity_max_rad_s"] == pytest.approx(drive_rad_s / 20)


def test_limits_and_stop_actions_reach_the_core():
    _, _, config = assembled("demo", "safety.on_estop=coast", "safety.on_fault=hold")
    linear, angular = config["limits"]["linear"], config["limits"]["angular"]
    assert linear == {
        "velocity_u_s": 1.0,
        "acceleration_u_s2": 1.0,
        "deceleration_u_s2": 1.5,
        "jerk_u_s3": 8.0,
    }
    assert (angular["velocity_u_s"], angular["deceleration_u_s2"]) == (2.0, 4.0)
    actions = (config["on_timeout"], config["on_fault"], config["on_estop"])
    assert actions == (rt.StopAction.RAMP, rt.StopAction.HOLD, rt.StopAction.COAST)


def test_a_line_carries_its_joints_under_the_cores_numbers():
    robot, profiles, _ = assembled("skid4")
    extra = robot.line["rs485"].model_copy(update={"port": "/dev/ttyUSB1", "cycle_hz": 20.0})
    joints = dict(robot.joint)
    joints["rear_left"] = joints["rear_left"].model_copy(update={"line": "rear"})
    robot = robot.model_copy(update={"line": {**robot.line, "rear": extra}, "joint": joints})
    front, rear = line_specs(robot, profiles)
    assert (front.index, rear.index, rear.port, rear.cycle_hz) == (0, 1, "/dev/ttyUSB1", 20.0)
    assert [(joint.index, joint.name) for joint in rear.joints] == [(2, "rear_left")]
    assert [joint.index for joint in front.joints] == [0, 1, 3]
    assert front.watchdog_s == robot.safety.drive_watchdog_s
    assert [joint["line"] for joint in core_config(robot, profiles)["joint"]] == [0, 0, 1, 0]


def test_asyncio_is_woken_as_often_as_the_fastest_publisher_sends():
    settings = loop_settings(
        load_robot(
            ROBOTS / "demo.toml", ["publish.console.kind=stdout", "publish.console.rate_hz=200"]
        )
    )
    assert settings.notify_hz == 200.0
    slow = loop_settings(load_robot(ROBOTS / "demo.toml", ["loop.rate_hz=10", "loop.cpu=[1, 2]"]))
    assert (slow.notify_hz, slow.rate_hz, slow.cpu) == (10.0, 10.0, (1, 2))


def in_range(name):
    node = DEFINITIONS["Limits"]["properties"][name]
    return st.floats(node["minimum"], node.get("maximum"), allow_nan=False)


@given(st.fixed_dictionaries({name: in_range(name) for name in Limits.model_fields}))
def test_limits_that_the_file_may_hold_are_limits_that_the_core_takes(values):
    assert rt.limits_problem(base_limits(Limits(**values))) is None


def extremes():
    """Yield every number of the sections that the core reads, at both ends of its range."""
    for section in ("Safety", "Odometry"):
        for name, node in DEFINITIONS[section]["properties"].items():
            if "minimum" in node:
                yield section.lower(), name, node["minimum"]
                yield section.lower(), name, node["maximum"]


@pytest.mark.parametrize(("section", "name", "value"), list(extremes()))
def test_the_core_takes_both_ends_of_every_range(section, name, value):
    robot = load_robot(ROBOTS / "demo.toml")
    changed = getattr(robot, section).model_copy(update={name: float(value)})
    robot = robot.model_copy(update={section: changed})
    rt.Loop(core_config(robot, robot.profiles), loop_settings(robot))
