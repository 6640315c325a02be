# SPDX-License-Identifier: Apache-2.0
"""Geometry from a recording with poses that another system has measured, such as motion capture.

The recording is cut into windows. For each one the motion in the poses is compared with the motion
that the wheels rolled. The deviations come from the scatter of the windows, so slip need not be
known."""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motord.api.geometry_fit import Array, Measure, Pose
from motord.commission.person import Failed
from motord_hal.base import bounded

COLUMNS = ("time_s", "x_m", "y_m", "heading_rad")
ROWS_MAX = 2_000_000
WINDOW_M = 0.6
"""Path of a window: long against the noise of a pose, short against the distance of a slip."""
WINDOWS_MIN = 20
DEVIATION = Pose(0.01, 0.01, 0.01, math.nan)
"""Weights of position and heading against each other, for a window."""


@dataclass(frozen=True, slots=True)
class Log:
    """Samples of a recording, in the order of time."""

    pose: Array
    """x_m, y_m, heading_rad; one row a sample; the heading is not wrapped."""
    left_m: Array
    right_m: Array


def read_csv(path: Path, sides: Mapping[str, str], radii_m: Mapping[str, float]) -> Log:
    """Read the columns time_s, x_m, y_m, heading_rad, and JOINT_rad for each joint: the angle of
    its wheel, positive forward, not wrapped. Raises Failed."""
    joints = [f"{name}_rad" for name in sides]
    rows: list[list[float]] = []
    try:
        with io.TextIOWrapper(bounded.opened(path), encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            lacking = [key for key in (*COLUMNS, *joints) if key not in (reader.fieldnames or ())]
            if lacking:
                raise Failed(
                    f"{path}: has no column {lacking[0]}; needed are "
                    f"{', '.join((*COLUMNS, *joints))}"
                )
            for number, row in enumerate(reader, 2):
                if len(rows) >= ROWS_MAX:
                    raise Failed(f"{path}: has more than {ROWS_MAX} rows: cut it")
                rows.append(_numbers(path, number, [row[key] for key in (*COLUMNS, *joints)]))
    except OSError as error:
        raise Failed(f"{path}: cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise Failed(f"{path}: cannot be read: {error}") from error
    if len(rows) < 2:
        raise Failed(f"{path}: has no samples")
    table = np.array(rows)
    if np.any(np.diff(table[:, 0]) < 0.0):
        raise Failed(f"{path}: time_s goes backward")
    pose = table[:, 1:4].copy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    return Log(pose, *sides_of(table[:, len(COLUMNS) :], sides, radii_m))


def sides_of(
    angles_rad: Array, sides: Mapping[str, str], radii_m: Mapping[str, float]
) -> tuple[Array, Array]:
    """Return the distances rolled by left and right. `angles_rad`: a column for each joint."""
    rolled: dict[str, list[Array]] = {"left": [], "right": []}
    for place, (name, side) in enumerate(sides.items()):
        rolled[side].append(angles_rad[:, place] * radii_m[name])
    left, right = (np.mean(rolled[side], axis=0) for side in ("left", "right"))
    return left, right


def windows(log: Log, window_m: float = WINDOW_M) -> list[Measure]:
    """Cut the recording into measures. Raises Failed for one that is too short."""
    travel = np.cumsum(np.abs(np.diff(log.left_m)) + np.abs(np.diff(log.right_m))) / 2.0
    cuts = [0]
    for place, so_far in enumerate(travel, 1):
        if so_far - (travel[cuts[-1] - 1] if cuts[-1] else 0.0) >= window_m:
            cuts.append(place)
    if len(cuts) <= WINDOWS_MIN:
        raise Failed(
            f"the log has {travel[-1] if len(travel) else 0.0:.1f} m of path; at least "
            f"{WINDOWS_MIN * window_m:.0f} m are needed, with turns to both sides"
        )
    return [_window(log, first, last) for first, last in itertools.pairwise(cuts)]


def _window(log: Log, first: int, last: int) -> Measure:
    begin, end = log.pose[first], log.pose[last]
    dx_m, dy_m, turn_rad = end - begin
    cos, sin = math.cos(begin[2]), math.sin(begin[2])
    found = Pose(float(dx_m * cos + dy_m * sin), float(dy_m * cos - dx_m * sin), float(turn_rad))
    left_m, right_m = (part[first : last + 1] - part[first] for part in (log.left_m, log.right_m))
    return Measure(f"window at sample {first}", left_m, right_m, found, DEVIATION)


def _numbers(path: Path, number: int, texts: list[str | None]) -> list[float]:
    try:
        values = [float(text or "") for text in texts]
    except ValueError as error:
        raise Failed(f"{path}:{number}: {error}") from error
    if not all(map(math.isfinite, values)):
        raise Failed(f"{path}:{number}: a value is not finite")
    return values
