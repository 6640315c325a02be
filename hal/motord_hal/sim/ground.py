# SPDX-License-Identifier: Apache-2.0
"""How wheels and ground move a base: the motion that fits best the travel of the rims."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

Row = tuple[float, float, float]
"""Shares of a speed at the ground in a motion forward, one to the left and a turn."""


class LeastSquares:
    """Least squares by Gram-Schmidt on the columns of the rows (Golub & Van Loan, Matrix
    Computations, 5.2.7) and back substitution."""

    def __init__(self, rows: Sequence[Row]) -> None:
        """Set the rows up. Raises ValueError if they do not determine the motion."""
        self._q: list[list[float]] = []
        self._r = [[0.0] * 3 for _ in range(3)]
        for k in range(3):
            column = [row[k] for row in rows]
            before = math.hypot(*column)
            for i, direction in enumerate(self._q):
                self._r[i][k] = part = _dot(direction, column)
                column = [c - part * d for c, d in zip(column, direction, strict=True)]
            self._r[k][k] = length = math.hypot(*column)
            if not length > 1e-3 * before:
                raise ValueError("the wheels do not determine how the base moves")
            self._q.append([c / length for c in column])

    def motion(self, values: Sequence[float]) -> Row:
        """Return the motion that fits these values best: forward and to the left in m, turn in
        rad."""
        found = [0.0, 0.0, 0.0]
        for i in (2, 1, 0):
            later = sum(self._r[i][k] * found[k] for k in range(i + 1, 3))
            found[i] = (_dot(self._q[i], values) - later) / self._r[i][i]
        return found[0], found[1], found[2]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Module:
    """A wheel of a base with steered wheels, and the joints that steer and drive it."""

    x_m: float
    y_m: float
    steering: str = ""
    """Joint whose angle is the wheel's direction; "": the wheel points straight ahead."""
    traction: str = ""
    """Joint that drives the wheel; "": the wheel rolls freely."""


class SteeredGround:
    """Wheels that roll in their direction and do not slide across it: the rolling and the sliding
    constraint of each (Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2.3). Contradictions
    between them are slip."""

    def __init__(self, modules: Sequence[Module], angle_rad: Callable[[str], float]) -> None:
        """Set the wheels up. `angle_rad` returns a joint's angle. Raises ValueError if the wheels
        do not determine the motion."""
        self._modules = tuple(modules)
        self._angle_rad = angle_rad
        self._steering = tuple({module.steering for module in modules if module.steering})
        self._angles: tuple[float, ...] = ()
        self._fit = self._fitted()

    def motion(self, rims_m: Callable[[str], float]) -> Row:
        """Return the base's motion. `rims_m` returns the travel of a joint's rim."""
        if self._angles != tuple(map(self._angle_rad, self._steering)):
            self._fit = self._fitted()
        values = []
        for module in self._modules:
            values.append(0.0)
            if module.traction:
                values.append(rims_m(module.traction))
        return self._fit.motion(values)

    def _fitted(self) -> LeastSquares:
        self._angles = tuple(map(self._angle_rad, self._steering))
        rows: list[Row] = []
        for module in self._modules:
            angle_rad = self._angle_rad(module.steering) if module.steering else 0.0
            sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
            x_m, y_m = module.x_m, module.y_m
            rows.append((-sine, cosine, x_m * cosine + y_m * sine))
            if module.traction:
                rows.append((cosine, sine, x_m * sine - y_m * cosine))
        return LeastSquares(rows)
