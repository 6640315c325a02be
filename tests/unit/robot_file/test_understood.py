# SPDX-License-Identifier: Apache-2.0
"""The summary of a robot file that `motord check` prints, as the program understands it."""

import math
from pathlib import Path

import pytest
from click.testing import CliRunner

from motord.cli import cli
from motord.config import load_robot
from motord.config.understood import understood

DIFFERS = 'joint.left.differs_in=["counts_per_turn", "gear_ratio"]'
ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


def found(robot, *settings):
    return understood(load_robot(ROBOTS / f"{robot}.toml", settings))


def test_the_wheels_rpm_follows_from_top_speed_and_radius():
    [left, right] = found("demo", "limits.linear_m_s=0.5").wheels
    assert left.velocity_rpm == right.velocity_rpm == pytest.approx(0.5 / 0.0825 * 60 / math.tau)


def test_a_gear_turns_the_motor_faster_and_a_count_into_less_travel():
    one = found("demo").wheels[0]
    geared = found("demo", "joint.left.gear_ratio=2.0", DIFFERS, "limits.linear_m_s=0.2").wheels[0]
    assert geared.motor_rpm == pytest.approx(2.0 * geared.velocity_rpm)
    assert geared.travel_per_count_mm == pytest.approx(one.travel_per_count_mm / 2.0)


def test_a_wheel_that_cannot_reach_the_limit_sets_the_top_speed():
    slow = found("demo", "joint.right.velocity_max_rad_s=4.0", "limits.linear_m_s=1.0")
    assert slow.top_m_s == pytest.approx(4.0 * 0.0825)
    assert slow.on_spot_rad_s == pytest.approx(2.0 * 4.0 * 0.0825 / 0.45)


def test_a_stop_takes_the_area_under_its_ramp():
    robot = found("demo", "limits.linear_m_s3=inf", "limits.linear_deceleration_m_s2=2.0")
    assert robot.stop_distance_m == pytest.approx(1.0**2 / (2.0 * 2.0))
    assert robot.lost_distance_m == pytest.approx(robot.stop_distance_m + 0.3)


def test_the_load_of_a_wire_doubles_with_its_rate():
    slow, fast = (
        found("demo", f"line.rs485.cycle_hz={rate_hz}").wires[0] for rate_hz in (20.0, 40.0)
    )
    assert fast.share == pytest.approx(2.0 * slow.share)
    assert fast.most_hz == pytest.approx(slow.most_hz)


def test_a_drive_without_a_watchdog_is_named():
    [watchdog] = found("pi5-bts7960").watchdogs
    assert watchdog.stops_within_s is None
    assert "kill -9" in watchdog.note
    [watchdog] = found("demo", "safety.drive_watchdog_s=0.4").watchdogs
    assert watchdog.stops_within_s == 0.4


def test_defaults_are_those_that_the_file_does_not_give():
    defaults = found("pi5-bts7960").defaults
    assert defaults["limits"]["linear_m_s3"] is None
    assert "linear_m_s" not in defaults["limits"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["joint.left.counts_per_turn=12", DIFFERS], "a count is 43.2 mm of travel"),
        (["joint.left.gear_ratio=0.001", DIFFERS], "the motor turns 0.001 times for a wheel turn"),
        (["limits.linear_m_s=5.0", "limits.linear_deceleration_m_s2=1.0"], "m to rest: is there"),
        (["base.wheel_radius_m=0.85"], "0.85 m is a wheel of 1.7 m across: is this right?"),
    ],
)
def test_an_implausible_value_is_questioned(settings, words):
    options = [part for setting in settings for part in ("--set", setting)]
    result = CliRunner().invoke(cli, ["check", str(ROBOTS / "demo.toml"), *options])
    assert result.exit_code == 0, result.output
    assert words in result.stdout
