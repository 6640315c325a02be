# SPDX-License-Identifier: Apache-2.0
"""The courses of the demonstration, and the error of odometry against the truth. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

# share of the whole time, m/s, rad/s: out, left, on, round to the right, back, a turn on the spot,
# home
COURSE = (
    (0.16, 0.60, 0.0),
    (0.14, 0.45, 1.0),
    (0.14, 0.60, 0.0),
    (0.24, 0.45, -1.1),
    (0.16, 0.60, 0.0),
    (0.06, 0.0, 1.2),
    (0.10, 0.50, 0.6),
)
CURVES = tuple(
    (share, linear_m_s or 0.45, angular_rad_s) for share, linear_m_s, angular_rad_s in COURSE
)
"""The same course for a base that cannot turn on the spot."""
Course = tuple[tuple[float, ...], ...]
"""Legs of a course: share of the whole time, m/s, rad/s, and, for a base that moves sideways, m/s
to the left."""
STRAFING: Course = (
    (0.14, 0.50, 0.0, 0.0),
    (0.14, 0.0, 0.0, 0.35),
    (0.14, 0.40, 0.0, -0.30),
    (0.16, 0.30, 0.6, 0.20),
    (0.14, -0.35, 0.0, -0.30),
    (0.08, 0.0, -1.0, 0.0),
    (0.20, 0.20, -0.5, -0.30),
)
"""Course of a base that moves sideways: out, sideways, diagonally, sideways in a curve, back
diagonally, a turn on the spot, home in a circle."""
CAR: Course = (
    (0.14, 0.60, 0.0),
    (0.16, 0.50, 0.6),
    (0.14, 0.40, 0.55),
    (0.14, -0.40, 0.55),
    (0.14, 0.40, 0.55),
    (0.12, 0.60, 0.0),
    (0.16, 0.50, -0.5),
)
"""Course of a car: out, a curve, a turn in three moves (forward left, backward right, forward
left), on, and a curve to the other side."""
DISTANCE_ERROR_MAX_PERCENT = 1.0
HEADING_ERROR_MAX_RAD = 0.02
ESTIMATE_ERROR_MAX_PERCENT = 50.0
"""Limit for the error of the distance if odometry is only an estimate. It is enough to find a wheel
that turns in the wrong direction."""


def command_at(elapsed_s: float, seconds: float, course: Course = COURSE) -> tuple[float, ...]:
    """Return the speeds of the course at this time: linear in m/s, angular in rad/s, and, if the
    course has it, lateral in m/s. They are zero after its end."""
    left = elapsed_s / seconds
    for share, *speeds in course:
        if left < share:
            return tuple(speeds)
        left -= share
    return 0.0, 0.0


@dataclass(frozen=True, slots=True)
class Pose:
    x_m: float
    y_m: float
    heading_rad: float
    distance_m: float


@dataclass(frozen=True, slots=True)
class Score:
    """The errors of odometry against the truth after one drive."""

    distance_m: float
    position_error_m: float
    heading_error_rad: float
    drift_percent: float
    """Position error as a part of the distance travelled."""
    distance_error_percent: float

    @property
    def ok(self) -> bool:
        worst = max(self.drift_percent, self.distance_error_percent)
        return (
            worst <= DISTANCE_ERROR_MAX_PERCENT and self.heading_error_rad <= HEADING_ERROR_MAX_RAD
        )

    @property
    def ok_as_estimate(self) -> bool:
        """Whether odometry is good for an estimate: it goes in the direction of the robot."""
        return self.distance_error_percent <= ESTIMATE_ERROR_MAX_PERCENT


def score(odometry: Pose, truth: Pose) -> Score:
    """Compare odometry with the truth. For a robot that did not move, drift and distance error are
    100 per cent."""
    position_error_m = math.hypot(odometry.x_m - truth.x_m, odometry.y_m - truth.y_m)
    turn_rad = odometry.heading_rad - truth.heading_rad
    moved = truth.distance_m > 0.0
    return Score(
        distance_m=odometry.distance_m,
        position_error_m=position_error_m,
        heading_error_rad=abs(math.atan2(math.sin(turn_rad), math.cos(turn_rad))),
        drift_percent=100.0 * position_error_m / truth.distance_m if moved else 100.0,
        distance_error_percent=(
            100.0 * abs(odometry.distance_m - truth.distance_m) / truth.distance_m
            if moved
            else 100.0
        ),
    )


def draw(path: list[tuple[float, float]], columns: int = 64, rows: int = 16) -> str:
    """Draw the path from above as text: o is the start, * the path, X the end. A character cell is
    twice as high as wide."""
    xs, ys = [x for x, _ in path], [y for _, y in path]
    # metres for each column; 1e-9 avoids a division by zero if the robot stood still
    scale = max((max(xs) - min(xs)) / (columns - 1), (max(ys) - min(ys)) / (2.0 * (rows - 1)), 1e-9)
    height = round((max(ys) - min(ys)) / (2.0 * scale)) + 1
    grid = [[" "] * columns for _ in range(height)]
    marks = ["*"] * len(path)
    marks[0], marks[-1] = "o", "X"
    for (x, y), mark in sorted(zip(path, marks, strict=True), key=lambda item: item[1] != "*"):
        column, row = round((x - min(xs)) / scale), round((max(ys) - y) / (2.0 * scale))
        grid[row][column] = mark
    return "\n".join("".join(row).rstrip() for row in grid)
