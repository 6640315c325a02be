# SPDX-License-Identifier: Apache-2.0
"""The twists that turn one wheel of a base and as few others as possible."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.commission.spin.procedure import wheels_of
from motord.commission.spin.wheel_turns import FASTER_MAX, together, turns_of
from motord.config import load_robot
from motord.config.sections.bases import wheel_row

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"


def rows_of(name):
    robot = load_robot(ROBOTS / f"{name}.toml")
    rows = {joint: tuple(wheel_row(robot.base, one)) for joint, one in robot.joint.items()}
    return rows, robot.base.strafes


def rim(row, turn):
    x, y, lever_m = row
    return x * turn.linear + y * turn.lateral + lever_m * turn.angular


@pytest.mark.parametrize("name", ["demo", "skid4", "mecanum4", "omni3", "lekiwi-base"])
def test_each_turn_is_a_twist_in_which_the_named_wheels_turn_and_the_others_rest(name):
    rows, strafes = rows_of(name)
    for joint in rows:
        turns = turns_of(rows, joint, strafes=strafes)
        assert turns
        for turn in turns:
            rims = {each: rim(row, turn) for each, row in rows.items()}
            assert rims == pytest.approx(dict(turn.rims))
            assert rims[joint] == pytest.approx(1.0)
            assert {each for each, speed in rims.items() if abs(speed) > 1e-9} == set(turn.joints)
            assert max(map(abs, rims.values())) <= FASTER_MAX
            assert strafes or turn.lateral == 0.0


@pytest.mark.parametrize(
    ("name", "joint", "count", "all_times"),
    [("demo", "left", 1, {"left"}), ("omni3", "rear", 1, {"rear"}),
     ("mecanum4", "front_left", 2, {"front_left"})],
)  # fmt: skip
def test_as_few_other_wheels_as_possible_turn(name, joint, count, all_times):
    rows, strafes = rows_of(name)
    turns = turns_of(rows, joint, strafes=strafes)
    assert len(turns) == count
    assert set(together(turns)) == all_times
    assert max(len(turn.joints) for turn in turns) == count


def test_wheels_of_one_side_turn_together():
    rows, strafes = rows_of("skid4")
    side = {joint for joint, row in rows.items() if row == rows["front_left"]}
    turns = turns_of(rows, "front_left", strafes=strafes)
    assert len(turns) == 1
    assert set(turns[0].joints) == side


@given(st.permutations(["front_left", "front_right", "rear_left", "rear_right"]))
def test_with_swapped_motors_the_wheel_that_turns_both_times_is_the_commanded_joints(wired):
    """`wired`: for each joint, the wheel that its motor turns."""
    rows, strafes = rows_of("mecanum4")
    wheel_of = dict(zip(rows, wired, strict=True))
    for joint in rows:
        seen = [
            {wheel_of[each] for each in turn.joints}
            for turn in turns_of(rows, joint, strafes=strafes)
        ]
        assert set.intersection(*seen) == {wheel_of[joint]}


def test_a_joint_without_a_place_among_the_wheels_has_no_turn():
    """`spin` refuses such a joint before its first question."""
    described = {
        "joints": ["left", "right", "steering"], "strafes": False,
        "wheel_rows": {"left": (1.0, 0.0, -0.2), "right": (1.0, 0.0, 0.2)},
        "wheel_radii_m": {"left": 0.1, "right": 0.1},
    }  # fmt: skip
    found = wheels_of(described)
    assert {name: len(wheel.turns) for name, wheel in found.items()} == {
        "left": 1, "right": 1, "steering": 0,
    }  # fmt: skip
    assert found["steering"].index == 2


def test_a_wheel_that_no_motion_turns_has_no_turn():
    rows = {"one": (0.0, 0.0, 0.0), "two": (1.0, 0.0, 0.2)}
    assert turns_of(rows, "one", strafes=False) == ()
