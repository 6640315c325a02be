# SPDX-License-Identifier: Apache-2.0
"""Findings from the first turns of the wheels."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from motord.commission.spin.findings import findings
from motord.commission.spin.procedure import Turned, both_times
from motord.commission.spin.steered import recognized
from motord.config import load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
RIGHT = {"direction": "forward"}


@pytest.fixture(scope="module")
def demo():
    return load_robot(ROBOTS / "demo.toml")


@pytest.fixture(scope="module")
def pins():
    return load_robot(ROBOTS / "pi4-encoders.toml")


def turned(joint, *, seen="", direction="forward", left=0.0, right=0.0, current_a=1.0, faults=()):
    counted_rad = {"left": left, "right": right}
    return Turned(
        joint=joint, commanded_rad=3.0, counted_rad=counted_rad, current_max_a=current_a,
        faults=faults, seen=seen, direction=direction,
    )  # fmt: skip


def good_left():
    return turned("left", seen="left", left=3.0)


def test_a_wheel_that_turns_forward_and_counts_forward_is_good(demo):
    found = findings(demo, [good_left(), turned("right", seen="right", right=3.0)])
    assert found.good
    assert not found.changes


def test_a_wheel_that_turns_backward_changes_inverted(demo):
    found = findings(demo, [turned("right", seen="right", direction="backward", right=3.0)])
    assert found.changes == {("joint", "right", "inverted"): False}


def test_swapped_wheels_swap_channels_and_keep_their_directions(demo):
    """Channel 1 turns the right wheel, which is mounted mirrored: forward for the left wheel is
    backward for it."""
    found = findings(
        demo,
        [
            turned("left", seen="right", direction="backward", left=3.0),
            turned("right", seen="left", direction="backward", right=3.0),
        ],
    )
    assert found.changes == {
        ("joint", "right", "channel"): 1,
        ("joint", "left", "channel"): 2,
    }


def test_swapped_wheels_that_turn_forward_change_direction_with_the_channel(demo):
    found = findings(
        demo,
        [
            turned("left", seen="right", left=3.0),
            turned("right", seen="left", right=3.0),
        ],
    )
    assert found.changes == {
        ("joint", "right", "channel"): 1, ("joint", "right", "inverted"): False,
        ("joint", "left", "channel"): 2, ("joint", "left", "inverted"): True,
    }  # fmt: skip


def test_one_swapped_wheel_alone_is_not_enough_to_change_the_file(demo):
    found = findings(demo, [turned("left", seen="right", left=3.0)])
    assert not found.changes
    assert "motord spin --all" in found.texts[-1]


def test_swapped_motor_plugs_are_mended_by_wiring(demo):
    found = findings(
        demo,
        [
            turned("left", seen="right", right=3.0),
            turned("right", seen="left", left=3.0),
        ],
    )
    assert not found.changes
    assert "swap the plugs of the two motors" in found.texts[-1]


def test_a_drives_encoder_that_counts_backward_is_rewired(demo):
    found = findings(demo, [turned("left", seen="left", left=-1.0, faults=("direction",))])
    assert not found.changes
    assert "turned against its set-point" in found.texts[0]
    assert "swap A and B" in found.texts[1]


def test_a_separate_encoder_that_counts_backward_is_reversed_in_the_file(pins):
    found = findings(pins, [turned("left", seen="left", left=-1.0)])
    before = pins.joint["left"].encoder.reversed
    assert found.changes == {("joint", "left", "encoder", "reversed"): not before}


def test_an_encoder_that_does_not_count_is_unplugged(demo):
    found = findings(demo, [turned("left", seen="left", faults=("stall",))])
    assert any("broken wire" in text for text in found.texts)
    assert not found.changes


def test_an_encoder_on_the_other_input_is_found(demo, pins):
    found = findings(demo, [turned("left", seen="left", right=3.0)])
    assert "the encoder of right counted" in found.texts[0]
    assert not found.changes
    found = findings(pins, [turned("left", seen="left", right=3.0)])
    assert found.changes["joint", "left", "encoder"]["kind"] == "gpio"


def test_too_many_counts_name_the_factor(demo):
    found = findings(demo, [turned("left", seen="left", left=12.0)])
    assert "counted 4 times the commanded angle" in found.texts[0]


@pytest.mark.parametrize(
    ("current_a", "words"), [(0.0, "drew no current"), (6.0, "blocked"), (None, "no current")]
)
def test_a_wheel_that_stands_is_judged_by_its_current(demo, current_a, words):
    found = findings(demo, [turned("left", current_a=current_a)])
    assert words in found.texts[0]


def test_a_partner_that_counts_in_only_one_of_two_turns_is_no_crossed_encoder(demo):
    first = turned("left", seen="left", left=0.0, right=3.0)
    second = turned("left", seen="left", left=0.0, right=0.0)
    found = findings(demo, [both_times([first, second])])
    assert "look for an unplugged encoder" in found.texts[0]
    stopped = replace(first, together=("left", "right"), faults=("stall",))
    assert "look for an unplugged encoder" in findings(demo, [stopped]).texts[-1]


def test_of_two_turns_the_smaller_count_of_each_wheel_stays():
    found = both_times(
        [turned("left", left=3.0, right=2.9, current_a=1.0),
         turned("left", left=2.5, right=0.01, current_a=4.0)]
    )  # fmt: skip
    assert found.counted_rad == {"left": 2.5, "right": 0.01}
    assert found.current_max_a == 4.0


# -------------------------------------------------------------------------------- steered wheels
LEFT, NONE, RIGHT = "left", "straight", "right"
PATTERNS = {"front_left_steering": (LEFT, NONE, RIGHT), "front_right_steering": (LEFT, NONE, LEFT)}


@pytest.fixture(scope="module")
def swerve():
    return load_robot(ROBOTS / "swerve4-servos.toml")


def pointed(joint, seen, *, reported_rad=0.35, off_rad=0.0):
    found = recognized(joint, PATTERNS[joint], seen)
    return replace(
        found, commanded_rad=0.35, counted_rad={joint: reported_rad},
        off_straight_rad=dict.fromkeys(seen, off_rad),
    )  # fmt: skip


def test_steering_that_points_as_it_should_changes_nothing(swerve):
    found = findings(swerve, [pointed(joint, PATTERNS) for joint in PATTERNS])
    assert found.good
    assert not found.changes


def test_a_steered_wheel_that_stood_and_one_that_is_blocked_are_named(swerve):
    stood = {"front_left_steering": (NONE, NONE, NONE)}
    found = findings(swerve, [pointed("front_left_steering", stood, reported_rad=0.0)])
    assert "did not turn" in found.texts[0]
    blocked = pointed("front_left_steering", PATTERNS, reported_rad=0.1)
    assert "it is blocked or too weak" in findings(swerve, [blocked]).texts[0]


def test_a_pattern_that_fits_no_joint_is_shown_and_changes_nothing(swerve):
    found = findings(swerve, [pointed("front_left_steering", {"front_left_steering": (LEFT,) * 3})])
    assert "pointed left, left, left instead of left, straight, right" in found.texts[0]
    assert not found.changes


def test_a_zero_follows_the_direction_that_the_file_will_have(swerve):
    """The wheel points to the left; there the count of an inverted servo is smaller."""
    name, off_counts = "front_left_steering", round(0.1 * 4096 / math.tau)
    straight = findings(swerve, [pointed(name, PATTERNS, off_rad=0.1)])
    assert straight.changes == {("joint", name, "zero_count"): 2048 - off_counts}
    inverted = {name: (RIGHT, NONE, LEFT)}
    turned = findings(swerve, [pointed(name, inverted, off_rad=0.1)])
    assert turned.changes == {
        ("joint", name, "inverted"): True,
        ("joint", name, "zero_count"): 2048 + off_counts,
    }
