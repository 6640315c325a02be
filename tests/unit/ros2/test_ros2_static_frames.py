# SPDX-License-Identifier: Apache-2.0
"""Transforms of frames that never move, as they are published."""

import math
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.bus.ros2.static_frames import static_transforms
from motord.bus.ros2.urdf import urdf
from motord.config import load_robot

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
STAMP_NS = 1_000_000_002
ANGLES = st.floats(-4.0, 4.0)


def fixed(origin="", kind="fixed", ends='<parent link="base_link"/><child link="lidar"/>'):
    return f'<robot name="r"><joint name="j" type="{kind}">{ends}{origin}</joint></robot>'


def test_the_generated_description_has_the_footprint_and_no_wheels():
    (frame,) = static_transforms(urdf(load_robot(DEMO)), STAMP_NS).transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ("base_link", "base_footprint")
    place, turn = frame.transform.translation, frame.transform.rotation
    assert (place.x, place.y, place.z) == (0.0, 0.0, 0.0)
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)
    assert frame.header.stamp == SimpleNamespace(sec=1, nanosec=2)


def test_frames_have_the_prefix_of_their_robot():
    (frame,) = static_transforms(fixed(), STAMP_NS, "r2/").transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ("r2/base_link", "r2/lidar")


def test_a_sensor_is_where_the_users_own_description_puts_it():
    (frame,) = static_transforms(fixed('<origin xyz="0.1 -0.2 0.3"/>'), STAMP_NS).transforms
    place = frame.transform.translation
    assert (place.x, place.y, place.z) == (0.1, -0.2, 0.3)
    assert frame.child_frame_id == "lidar"


def turned(turn, vector):
    """Return the vector, turned by the quaternion's rotation matrix."""
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return tuple(sum(a * b for a, b in zip(row, vector, strict=True)) for row in rows)


def about(axis, angle_rad, vector):
    """Return the vector, turned about one of the fixed axes (0 is x, 1 y, 2 z)."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
    made = list(vector)
    made[one] = cosine * vector[one] - sine * vector[other]
    made[other] = sine * vector[one] + cosine * vector[other]
    return tuple(made)


@given(ANGLES, ANGLES, ANGLES)
def test_angles_are_turns_about_x_then_y_then_z(roll_rad, pitch_rad, yaw_rad):
    origin = f'<origin rpy="{roll_rad} {pitch_rad} {yaw_rad}"/>'
    (frame,) = static_transforms(fixed(origin), STAMP_NS).transforms
    vector = (0.3, -1.2, 0.7)
    theirs = about(2, yaw_rad, about(1, pitch_rad, about(0, roll_rad, vector)))
    assert turned(frame.transform.rotation, vector) == pytest.approx(theirs, abs=1e-12)


def test_joints_that_turn_are_left_to_readers_of_joint_states():
    assert static_transforms(fixed(kind="continuous"), STAMP_NS).transforms == ()


@pytest.mark.parametrize(
    "wrong",
    [
        "not a description", fixed('<origin xyz="1 2"/>'), fixed('<origin xyz="1 2 nan"/>'),
        fixed('<origin rpy="a b c"/>'), fixed(ends='<parent link="base_link"/>'),
    ],
)  # fmt: skip
def test_an_invalid_description_is_reported(wrong):
    with pytest.raises(ValueError):
        static_transforms(wrong, STAMP_NS)
