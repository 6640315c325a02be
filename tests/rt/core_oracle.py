# SPDX-License-Identifier: Apache-2.0
"""Oracle for the odometry, from the textbook and with other means than the C: Jacobians as arrays,
the arc as a complex integral, a straight line only where there is no turn at all."""

from __future__ import annotations

import math

import numpy as np


class Pose:
    """Dead reckoning from two sides: Siegwart & Nourbakhsh, Autonomous Mobile Robots, 5.2.4."""

    def __init__(
        self, track_m: float, per_m: float, per_rad: float, floor_m2: float, floor_rad2: float
    ) -> None:
        self.track_m, self.per_m, self.per_rad = track_m, per_m, per_rad
        self.floors = np.array([floor_m2, floor_m2, floor_rad2])
        self.pose = np.zeros(3)
        self.covariance = np.diag(self.floors)

    def roll(self, left_m: float, right_m: float) -> None:
        turn = (right_m - left_m) / self.track_m
        distance = (right_m + left_m) / 2.0
        heading = self.pose[2]
        if turn == 0.0:
            step = distance * np.array([math.cos(heading), math.sin(heading)])
        else:
            # rotate about the centre of the circle; a complex number keeps tiny turns exact
            chord = distance * (np.expm1(1j * turn) / (1j * turn))
            along = chord * np.exp(1j * heading)
            step = np.array([along.real, along.imag])
        self._spread(left_m, right_m, distance, turn, heading + turn / 2.0)
        self.pose[:2] += step
        self.pose[2] = math.remainder(heading + turn, 2.0 * math.pi)

    def _spread(
        self, left_m: float, right_m: float, distance: float, turn: float, middle: float
    ) -> None:
        sine, cosine = math.sin(middle), math.cos(middle)
        motion = np.array([[1, 0, -distance * sine], [0, 1, distance * cosine], [0, 0, 1]])
        lever = distance / (2.0 * self.track_m)
        wheels = np.array(
            [
                [cosine / 2 - lever * sine, cosine / 2 + lever * sine],
                [sine / 2 + lever * cosine, sine / 2 - lever * cosine],
                [1 / self.track_m, -1 / self.track_m],
            ]
        )
        noise = np.diag([self.per_m * abs(right_m), self.per_m * abs(left_m)])
        grown = motion @ self.covariance @ motion.T + wheels @ noise @ wheels.T
        grown[2, 2] += self.per_rad * abs(turn)
        np.fill_diagonal(grown, np.maximum(grown.diagonal(), self.floors))
        self.covariance = grown

    def six(self) -> list[float]:
        p = self.covariance
        return [p[0, 0], p[0, 1], p[0, 2], p[1, 1], p[1, 2], p[2, 2]]
