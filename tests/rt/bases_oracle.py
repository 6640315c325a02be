# SPDX-License-Identifier: Apache-2.0
"""Oracle for bases without steering, from the textbook and with numpy: each wheel by the geometry
of its contact point (Lynch & Park, Modern Robotics, 2017, 13.2), the inverse as numpy's
pseudo-inverse, the pose by the matrix exponential of the twist."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

RADIUS_M = 0.05


def omni(place_m: Sequence[float], rolling_rad: float) -> np.ndarray:
    """Return the wheel's row: the floor's speed at the contact point, in the rolling direction."""
    x, y = place_m
    ground = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])  # speed of the contact point: v + w × p
    return np.array([math.cos(rolling_rad), math.sin(rolling_rad)]) @ ground


def mecanum(place_m: Sequence[float], roller_rad: float) -> np.ndarray:
    """Return the wheel's row. A roller moves freely across its axis: rim and floor agree along it
    alone."""
    x, y = place_m
    axis = np.array([math.cos(roller_rad), math.sin(roller_rad)])
    ground = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
    return axis @ ground / axis[0]  # the rim rolls along x


def rows_of(kind: str) -> np.ndarray:
    """Return the wheels' rows: factors of (linear, lateral, angular) in each wheel's rim speed."""
    if kind == "mecanum":
        corners = [(0.2, 0.15, -1), (0.2, -0.15, 1), (-0.2, 0.15, 1), (-0.2, -0.15, -1)]
        return np.array([mecanum((x, y), sign * math.pi / 4.0) for x, y, sign in corners])
    if kind == "skid":
        return np.array([[1.0, 0.0, side * 0.25] for side in (-1.0, 1.0, -1.0, 1.0)])
    if kind == "differential":
        return np.array([[1.0, 0.0, side * 0.25] for side in (-1.0, 1.0)])
    count = int(kind.removeprefix("omni"))
    angles = [math.tau * k / count + 0.3 for k in range(count)]
    return np.array(
        [omni((0.125 * math.cos(a), 0.125 * math.sin(a)), a + math.pi / 2.0) for a in angles]
    )


KINDS = ("differential", "skid", "mecanum", "omni3", "omni4", "omni5", "omni8")
STRAFING = tuple(kind for kind in KINDS if kind not in ("differential", "skid"))


def twist_of(rows: np.ndarray, rims_m_s: Sequence[float]) -> np.ndarray:
    """Return the twist by least squares; where it is not determined, the smallest one."""
    return np.linalg.pinv(rows) @ np.asarray(rims_m_s)


def moved(pose: np.ndarray, twist: Sequence[float], seconds: float) -> np.ndarray:
    """Return the pose (x, y, heading) after a constant twist of the body: a product of matrices,
    with the exponential as its series."""
    vx, vy, w = (part * seconds for part in twist)
    generator = np.array([[0.0, -w, vx], [w, 0.0, vy], [0.0, 0.0, 0.0]])
    step, term = np.eye(3), np.eye(3)
    for k in range(1, 40):
        term = term @ generator / k
        step = step + term
    c, s = math.cos(pose[2]), math.sin(pose[2])
    end = np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]]) @ step
    return np.array([end[0, 2], end[1, 2], math.atan2(end[1, 0], end[0, 0])])
