# SPDX-License-Identifier: Apache-2.0
"""The demonstration's course, and how well odometry followed the truth: pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

# share of the whole time, m/s, rad/s: out, left, on, right round, back, a turn on the spot, home
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
"""For a base that cannot turn on the spot."""
Course = tuple[tuple[float, ...], ...]
"""Share, m/s, rad/s, and m/s to the left where the base moves sideways."""
STRAFING: Course = (
    (0.14, 0.50, 0.0, 0.0),
    (0.14, 0.0, 0.0, 0.35),
    (0.14, 0.40, 0.0, -0.30),
    (0.16, 0.30, 0.6, 0.20),
    (0.14, -0.35, 0.0, -0.30),
    (0.08, 0.0, -1.0, 0.0),
    (0.20, 0.20, -0.5, -0.30),
)
"""Out, sideways, aslant, sideways in a curve, back aslant, a turn on the spot, home in a circle."""
CAR: Course = (
    (0.14, 0.60, 0.0),
    (0.16, 0.50, 0.6),
    (0.14, 0.40, 0.55),
    (0.14, -0.40, 0.55),
    (0.14, 0.40, 0.55),
    (0.12, 0.60, 0.0),
    (0.16, 0.50, -0.5),
)
"""Out, a curve, a turn in three moves (forward left, backward right, forward left), on, and a curve
to the other side."""
DISTANCE_ERROR_MAX_PERCENT = 1.0
HEADING_ERROR_MAX_RAD = 0.02
ESTIMATE_ERROR_MAX_PERCENT = 50.0
"""Of the distance, where odometry is only an estimate: a wheel that turns in the wrong direction is
found."""


def command_at(elapsed_s: float, seconds: float, course: Course = COURSE) -> tuple[float, ...]:
    """The course's speeds at this moment: (linear m/s, angular rad/s), then lateral m/s where the
    course has it; zero after its end."""
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
    """Odometry against truth after the same drive."""

    distance_m: float
    position_error_m: float
    heading_error_rad: float
    drift_percent: float
    """Position error per distance travelled."""
    distance_error_percent: float

    @property
    def ok(self) -> bool:
        worst = max(self.drift_percent, self.distance_error_percent)
        return (
            worst <= DISTANCE_ERROR_MAX_PERCENT and self.heading_error_rad <= HEADING_ERROR_MAX_RAD
        )

    @property
    def ok_as_estimate(self) -> bool:
        """Only whether odometry goes in the direction in which the robot goes."""
        return self.distance_error_percent <= ESTIMATE_ERROR_MAX_PERCENT


def score(odometry: Pose, truth: Pose) -> Score:
    """A robot that did not move has drifted by 100 per cent: there is nothing to be good at."""
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
    """The path from above: o the start, * the path, X the end. A cell is twice as high as wide."""
    xs, ys = [x for x, _ in path], [y for _, y in path]
    # metres a column; a robot that stood still is one cell, not a division by zero
    scale = max((max(xs) - min(xs)) / (columns - 1), (max(ys) - min(ys)) / (2.0 * (rows - 1)), 1e-9)
    height = round((max(ys) - min(ys)) / (2.0 * scale)) + 1
    grid = [[" "] * columns for _ in range(height)]
    marks = ["*"] * len(path)
    marks[0], marks[-1] = "o", "X"
    for (x, y), mark in sorted(zip(path, marks, strict=True), key=lambda item: item[1] != "*"):
        column, row = round((x - min(xs)) / scale), round((max(ys) - y) / (2.0 * scale))
        grid[row][column] = mark
    return "\n".join("".join(row).rstrip() for row in grid)
