# SPDX-License-Identifier: Apache-2.0
"""The times of [safety] are judged by the line that has to keep them, and by how far the robot goes
in them."""

from pathlib import Path

import pytest

from motord.cli.files.check_text import understood_rows
from motord.config import load_robot
from motord.config.problems import ConfigError

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
LONG = {
    "command_timeout_s": 5.0,
    "feedback_timeout_s": 5.0,
    "heartbeat_timeout_s": 5.0,
    "drive_watchdog_s": 10.0,
}
MEANT = "safety.timeout_travel_max_m=100"


def demo(*settings):
    return load_robot(ROBOTS / "demo.toml", settings)


def warned(robot, key):
    return [one.text for one in robot.warnings if key in str(one)]


@pytest.mark.parametrize("key", LONG)
def test_a_time_in_which_the_robot_goes_five_metres_is_refused_unless_it_is_meant(key):
    setting = f"safety.{key}={LONG[key]}"
    with pytest.raises(ConfigError, match=rf"{key}: in .* s the robot goes .* m at its limit"):
        demo(setting)
    assert "is there so much room" in "".join(warned(demo(setting, MEANT), key))


@pytest.mark.parametrize("key", LONG)
def test_a_time_in_which_the_robot_goes_more_than_half_a_metre_is_a_warning(key):
    assert not warned(demo(f"safety.{key}=0.5"), f"safety.{key}")
    assert warned(demo(f"safety.{key}=0.51"), f"safety.{key}")


def test_the_same_time_is_judged_by_the_robots_own_speed():
    assert demo("safety.command_timeout_s=5", "limits.linear_m_s=0.1")
    wheels = [f"joint.{name}.velocity_max_rad_s=1.2" for name in ("left", "right")]
    assert demo("safety.command_timeout_s=5", *wheels).warnings  # 0.1 m/s is all its wheels do


def test_the_fixed_watchdog_of_a_drive_is_judged_too_and_cannot_be_refused():
    fast = load_robot(ROBOTS / "hoverboard-rover.toml", ("limits.linear_m_s=2.0",))
    assert any("the watchdog of hoverboard is fixed: in 0.8 s" in w.text for w in fast.warnings)


def test_a_joint_without_a_base_is_judged_by_its_turns():
    calm = load_robot(ROBOTS / "pan-tilt.toml")
    assert not any("fastest joint turns" in w.text for w in calm.warnings)
    late = load_robot(ROBOTS / "pan-tilt.toml", ("safety.feedback_timeout_s=5",))
    assert any("fastest joint turns by 10.0 rad" in w.text for w in late.warnings)


@pytest.mark.parametrize("robot", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_check_shows_every_time_with_its_distance(robot):
    rows = [row for row in understood_rows(load_robot(robot)) if row.startswith("reacts after")]
    for key in ("command_timeout_s", "feedback_timeout_s", "heartbeat_timeout_s"):
        assert sum(row.endswith(f": {key}") for row in rows) == 1
    assert all(" m at top speed): " in row or " rad of the fastest joint): " in row for row in rows)


def test_the_feedback_time_out_has_room_for_a_lost_and_a_late_reply():
    slow = ("line.rs485.cycle_hz=8",)
    with pytest.raises(ConfigError, match=r"0\.25 s is shorter than three cycles .*0\.375 s"):
        demo(*slow)
    assert demo(*slow, "safety.feedback_timeout_s=0.375")
    with pytest.raises(ConfigError, match="three cycles"):
        demo("joint.left.cycle_hz=8")  # one joint alone


def test_a_time_that_one_lost_reply_exceeds_is_a_warning():
    short = "safety.feedback_timeout_s=0.12"  # three cycles, 25 ms, and 50 ms: 0.147 s
    (text,) = warned(demo(short), "safety.feedback_timeout_s")
    assert "when a reply is lost or late, a drive is without an exchange for up to 0.147 s" in text
    assert not warned(demo("safety.feedback_timeout_s=0.148"), "safety.feedback_timeout_s")
    given = [f"joint.{name}.reply_timeout_s=0.2" for name in ("left", "right")]
    (text,) = warned(demo(*given), "safety.feedback_timeout_s")
    assert "0.322 s" in text
    watched = demo("safety.drive_watchdog_s=0.1")
    assert warned(watched, "safety.drive_watchdog_s")


@pytest.mark.parametrize("robot", sorted(ROBOTS.glob("*.toml")), ids=lambda path: path.stem)
def test_one_lost_reply_is_no_fault_for_any_robot_of_the_project(robot):
    assert not any("when a reply is lost" in one.text for one in load_robot(robot).warnings)
