# SPDX-License-Identifier: Apache-2.0
"""Fit of wheel radii and track to paths and to measures at their ends."""

import math
import random

import numpy as np
import pytest

from motord.api.geometry_fit import BadData, Factors, Measure, Pose, end_pose, fit

TRACK_M = 0.45
TRUE = Factors(1.03, 1.02, 0.96)
TAPE = Pose(0.001, 0.001, math.radians(0.5), 0.001)


class Walker:
    """A path as the odometry computes it with the present geometry, for legs and turns."""

    def __init__(self):
        self.left, self.right = [0.0], [0.0]

    def go(self, left_m, right_m, steps=50):
        for _ in range(steps):
            self.left.append(self.left[-1] + left_m / steps)
            self.right.append(self.right[-1] + right_m / steps)
        return self

    def forward(self, distance_m):
        return self.go(distance_m, distance_m)

    def turn(self, angle_rad):
        return self.go(-angle_rad * TRACK_M / 2.0, angle_rad * TRACK_M / 2.0)

    def square(self, side_m, sign):
        for _ in range(4):
            self.forward(side_m).turn(sign * math.pi / 2.0)
        return self

    @property
    def path(self):
        return np.array(self.left), np.array(self.right)


def measured(name, walker, keys, true=TRUE, noise=None):
    """Return a person's measure of the path's end by tape, to a millimetre and half a degree."""
    pose = end_pose(*walker.path, TRACK_M, true)
    found = {}
    for key in keys:
        value = getattr(pose, key)
        if noise is not None:
            value += noise.gauss(0.0, getattr(TAPE, key))
        found[key] = value
    return Measure(name, *walker.path, Pose(**found), TAPE)


def whole(noise=None, true=TRUE):
    measures = [
        measured("straight", Walker().forward(3.0), ("x_m", "y_m"), true, noise),
        measured("left turns", Walker().turn(4 * math.pi), ("heading_rad",), true, noise),
        measured("right turns", Walker().turn(-4 * math.pi), ("heading_rad",), true, noise),
    ]
    return measures + [
        measured(f"square {sign}", Walker().square(2.0, sign), ("x_m", "y_m"), true, noise)
        for sign in (1.0, -1.0)
    ]


def square_error_m(believed, sign):
    """Return how far from its start a square of 4 m ends. The odometry uses the geometry
    `believed`, the base has TRUE; both are factors of the present geometry."""
    walker = Walker()
    for _ in range(4):
        walker.go(4.0 / believed.left, 4.0 / believed.right)
        arm_m = sign * math.pi / 2.0 * TRACK_M * believed.track / 2.0
        walker.go(-arm_m / believed.left, arm_m / believed.right)
    end = end_pose(*walker.path, TRACK_M, TRUE)
    return math.hypot(end.x_m, end.y_m)


def test_exact_measures_give_the_exact_geometry():
    found = fit(whole(), TRACK_M, ("scale", "ratio", "track")).factors
    for one, other in zip((found.left, found.right, found.track), (1.03, 1.02, 0.96), strict=True):
        assert one == pytest.approx(other, rel=1e-8)


@pytest.mark.parametrize("seed", range(10))
def test_a_tape_finds_radii_and_track_and_a_square_of_four_metres_closes_ten_times_better(seed):
    found = fit(whole(random.Random(seed)), TRACK_M, ("scale", "ratio", "track"))
    assert found.factors.left == pytest.approx(1.03, rel=0.003)
    assert found.factors.right == pytest.approx(1.02, rel=0.003)
    assert found.factors.track == pytest.approx(0.96, rel=0.003)
    for sign in (1.0, -1.0):
        before_m = square_error_m(Factors(), sign)
        assert before_m > 0.1
        assert before_m > 10.0 * square_error_m(found.factors, sign)


def test_deviations_are_those_of_repeated_calibrations():
    runs = [
        fit(whole(random.Random(seed)), TRACK_M, ("scale", "ratio", "track")) for seed in range(60)
    ]
    for name in ("left", "right", "track"):
        spread = np.std([getattr(run.factors, name) for run in runs])
        mean = np.mean([getattr(run.deviations, name) for run in runs])
        assert 0.6 < spread / mean < 1.6


def test_squares_in_both_directions_agree_with_the_closed_form_of_umbmark():
    """Borenstein & Feng 1996: alpha = (x_cw + x_ccw) / (-4 L), beta = (x_cw - x_ccw) / (-4 L),
    E_b = (pi / 2) / (pi / 2 - alpha), R = (L / 2) / sin(beta / 2), E_d = (R + b/2) / (R - b/2)."""
    small = Factors(1.0005, 0.9995, 0.998)
    side_m = 4.0
    squares = {
        sign: measured("square", Walker().square(side_m, sign), ("x_m", "y_m"), small)
        for sign in (1.0, -1.0)
    }
    x_ccw_m, x_cw_m = (squares[sign].found.x_m for sign in (1.0, -1.0))
    alpha_rad = (x_cw_m + x_ccw_m) / (-4.0 * side_m)
    beta_rad = (x_cw_m - x_ccw_m) / (-4.0 * side_m)
    track_error = (math.pi / 2.0) / (math.pi / 2.0 - alpha_rad)
    radius_m = side_m / 2.0 / math.sin(beta_rad / 2.0)
    ratio = (radius_m + TRACK_M / 2.0) / (radius_m - TRACK_M / 2.0)
    found = fit(list(squares.values()), TRACK_M, ("ratio", "track")).factors
    assert abs(found.track - 1.0) == pytest.approx(abs(track_error - 1.0), rel=0.05)
    assert abs(found.right / found.left - 1.0) == pytest.approx(abs(ratio - 1.0), rel=0.05)


def test_a_square_alone_does_not_determine_the_size():
    squares = whole()[3:]
    with pytest.raises(BadData, match=r"do not determine scale, ratio, track"):
        fit(squares, TRACK_M, ("scale", "ratio", "track"))


def test_a_contradictory_measure_is_refused_and_named():
    measures = whole()
    bad = measures[3]
    found = Pose(bad.found.x_m + 0.3, bad.found.y_m)
    measures[3] = Measure(bad.name, bad.left_m, bad.right_m, found, bad.deviation)
    with pytest.raises(BadData, match=r"contradict each other: \"square 1.0\" is off by"):
        fit(measures, TRACK_M, ("scale", "ratio", "track"))


def test_a_factor_too_far_from_one_is_refused():
    walker = Walker().forward(1.0)
    measure = Measure("straight", *walker.path, Pose(distance_m=2.0), TAPE)
    with pytest.raises(BadData, match="too far from 1"):
        fit([measure], TRACK_M, ("scale",))


def test_a_value_that_is_not_finite_is_refused():
    walker = Walker().forward(1.0)
    measure = Measure("straight", *walker.path, Pose(distance_m=math.inf), TAPE)
    with pytest.raises(BadData, match="finite"):
        fit([measure], TRACK_M, ("scale",))
