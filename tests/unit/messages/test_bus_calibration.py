# SPDX-License-Identifier: Apache-2.0
"""Calibration of wheel radius and track with a distance that a person has measured."""

import math

import pytest
from tests.unit.messages.bus_views import joint, view

from motord.api.motion import End
from motord.bus.messages.calibration import REST_S, Calibration, measure

STALE_S = 0.25


def state(at_ms, **changes):
    return view(at_ms, **({"at_rest": True} | changes)).snapshot


def begun(quantity, true_u, timeout_s=0.0):
    asked = measure(quantity, true_u, true_u, timeout_s)
    return Calibration(asked, state(0), 0, STALE_S)


def pushed(calibration, moves, rest_s=REST_S):
    """Move to a pose every 20 ms, then rest; return the last step of the calibration."""
    at_ms, found = 0, None
    for pose in moves:
        at_ms += 20
        found = calibration.step(state(at_ms, at_rest=False, **pose), at_ms * 1_000_000)
        assert found is None
    for _ in range(round(rest_s * 50)):
        at_ms += 20
        found = calibration.step(state(at_ms, **moves[-1]), at_ms * 1_000_000)
        if found is not None:
            return found
    return found


def straight(distance_m, turn_rad=0.0, steps=100):
    return [
        {"x_m": distance_m * part / steps, "heading_rad": turn_rad * part / steps}
        for part in range(1, steps + 1)
    ]


def turning(angle_rad, steps=100):
    return [
        {"heading_rad": math.remainder(angle_rad * part / steps, math.tau)}
        for part in range(1, steps + 1)
    ]


def test_wheels_that_count_too_little_are_larger_than_thought():
    found = pushed(begun("wheel_radius", 2.0), straight(1.9))
    assert found.end is End.SUCCEEDED
    assert found.factor == pytest.approx(2.0 / 1.9)


def test_a_distance_backwards_counts_like_one_forwards():
    found = pushed(begun("wheel_radius", 2.0), straight(-2.1))
    assert found.factor == pytest.approx(2.0 / 2.1)


def test_a_heading_that_counts_too_much_means_a_wider_track():
    true_rad = 2.0 * math.tau
    found = pushed(begun("track", true_rad), turning(-1.1 * true_rad))
    assert found.end is End.SUCCEEDED
    assert found.factor == pytest.approx(1.1)


def test_a_calibration_ends_only_when_the_robot_has_rested():
    assert pushed(begun("wheel_radius", 2.0), straight(1.9), rest_s=REST_S - 0.1) is None


def test_a_pause_on_the_first_half_of_the_distance_is_not_the_end():
    assert pushed(begun("wheel_radius", 2.0), straight(0.9), rest_s=10.0) is None


def test_a_curved_path_gives_nothing():
    found = pushed(begun("wheel_radius", 2.0), straight(1.9, turn_rad=0.3))
    assert (found.end, found.factor) == (End.ABORTED, 0.0)
    assert "turned" in found.why


def test_a_contradictory_distance_gives_nothing():
    found = pushed(begun("wheel_radius", 2.0), straight(3.0))
    assert (found.end, found.factor) == (End.ABORTED, 0.0)


def test_without_a_distance_a_calibration_ends_at_its_time_out():
    found = pushed(begun("wheel_radius", 2.0, timeout_s=5.0), straight(0.5), rest_s=10.0)
    assert found.end is End.ABORTED
    assert "within 5 s" in found.why


@pytest.mark.parametrize(
    "change",
    [
        {"joints": (joint(stale=True), joint())},
        {"odometry_epoch": 1.0},
        {"x_m": math.nan},
        {"odometry_stamp_ns": 100 * 10**9},
        {"stamp_ns": 100 * 10**9},
    ],
)
def test_an_invalid_odometry_gives_nothing(change):
    found = begun("wheel_radius", 2.0).step(state(20, **change), 20_000_000)
    assert (found.end, found.factor) == (End.ABORTED, 0.0)


@pytest.mark.parametrize(
    "wrong",
    [
        ("wheel", 2.0, 0.0, 0.0), ("wheel_radius", 0.0, 10.0, 0.0), ("track", 10.0, 1.0, 0.0),
        ("wheel_radius", math.nan, 0.0, 0.0), ("track", 0.0, math.inf, 0.0),
        ("wheel_radius", 2.0, 0.0, math.nan), ("wheel_radius", 2.0, 0.0, -1.0),
    ],
)  # fmt: skip
def test_an_invalid_measure_is_refused(wrong):
    with pytest.raises(ValueError):
        measure(*wrong)
