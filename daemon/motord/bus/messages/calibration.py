# SPDX-License-Identifier: Apache-2.0
"""Computes the wheels' radius or the track from a distance that a person has measured.

Nothing here moves the robot: it is watched while a person drives or pushes it from one mark to
another. The true distance or angle is known beforehand; the odometry gives the measured one.

`motord.api.geometry_fit` computes the factor, as in `motord calibrate`, from one measure with one
unknown.
"""

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass
from typing import Literal

from motord.api.motion import End, Travel, problem
from motord.api.snapshot import Snapshot
from motord.base.extras import how_to_install

Quantity = Literal["wheel_radius", "track"]
REST_S = 2.0
"""A robot that rests for this long beyond half of the distance has arrived."""
DISTANCE_MIN_M, DISTANCE_MAX_M = 0.2, 100.0
ANGLE_MIN_RAD, ANGLE_MAX_RAD = math.pi, 100.0 * math.tau
TURN_MAX_RAD = 0.1
"""Greatest turn of a path that counts as straight."""
TIMEOUT_S, TIMEOUT_MAX_S = 300.0, 3600.0
_NS = 1e-9
_TRACK_M = 2.0
"""Track for the fit. It may have any value: the factor does not depend on it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """The quantity to find, and its true distance: m for wheel_radius, rad for track."""

    quantity: Quantity
    true_u: float
    timeout_s: float


def measure(
    quantity: str, true_distance_m: float, true_angle_rad: float, timeout_s: float
) -> Measure:
    """Return the measure for a request. Raises ValueError with a text for the client."""
    if not 0.0 <= timeout_s <= TIMEOUT_MAX_S:
        raise ValueError(f"a time-out of {timeout_s:g} s: it is from 0 to {TIMEOUT_MAX_S:g} s")
    timeout_s = timeout_s or TIMEOUT_S
    if quantity == "wheel_radius":
        if not DISTANCE_MIN_M <= true_distance_m <= DISTANCE_MAX_M:
            raise ValueError(f"true_distance_m is {DISTANCE_MIN_M} to {DISTANCE_MAX_M} m")
        return Measure(quantity="wheel_radius", true_u=true_distance_m, timeout_s=timeout_s)
    if quantity == "track":
        if not ANGLE_MIN_RAD <= true_angle_rad <= ANGLE_MAX_RAD:
            raise ValueError(f"true_angle_rad is {ANGLE_MIN_RAD:.2f} to {ANGLE_MAX_RAD:.0f} rad")
        return Measure(quantity="track", true_u=true_angle_rad, timeout_s=timeout_s)
    raise ValueError('quantity is "wheel_radius" or "track"')


@dataclass(frozen=True, slots=True)
class Found:
    """End of a calibration. `factor`: what the quantity has to be multiplied by; 0 if it failed."""

    end: End
    factor: float = 0.0
    why: str = ""


class Calibration:
    """A calibration in progress. Call `step` again and again, with the newest snapshot."""

    def __init__(self, asked: Measure, start: Snapshot, now_ns: int, stale_s: float) -> None:
        self.travel = Travel(start)
        self._asked = asked
        self._stale_s = stale_s
        self._start_ns = now_ns
        self._moved_ns = now_ns
        self._distance_m, self._angle_rad = [0.0], [0.0]

    def step(self, snapshot: Snapshot, now_ns: int) -> Found | None:
        """Take a snapshot; return the end of the calibration, or None while it goes on."""
        why = problem(snapshot, now_ns, self._stale_s) or self.travel.add(snapshot)
        if why is not None:
            return Found(End.ABORTED, why=why)
        self._distance_m.append(self.travel.distance_m)
        self._angle_rad.append(self.travel.angle_rad)
        if not snapshot.at_rest:
            self._moved_ns = now_ns
        halfway = self._done_u() >= self._asked.true_u / 2.0
        if halfway and (now_ns - self._moved_ns) * _NS >= REST_S:
            return self._found()
        if (now_ns - self._start_ns) * _NS > self._asked.timeout_s:
            why = f"no distance of {self._asked.true_u:g} within {self._asked.timeout_s:g} s"
            return Found(End.ABORTED, why=why)
        return None

    def _done_u(self) -> float:
        straight = self._asked.quantity == "wheel_radius"
        return abs(self.travel.distance_m if straight else self.travel.angle_rad)

    def _found(self) -> Found:
        if importlib.util.find_spec("numpy") is None:
            why = f"numpy is not installed: {how_to_install('calibrate')}"
            return Found(End.ABORTED, why=why)
        import numpy as np

        from motord.api.geometry_fit import BadData, Measure, Pose, fit

        straight = self._asked.quantity == "wheel_radius"
        if straight and abs(self.travel.angle_rad) > TURN_MAX_RAD:
            why = f"it turned by {self.travel.angle_rad:.2f} rad: the path must be straight"
            return Found(End.ABORTED, why=why)
        true_u = math.copysign(
            self._asked.true_u, self.travel.distance_m if straight else self.travel.angle_rad
        )
        pose = Pose(distance_m=true_u) if straight else Pose(heading_rad=true_u)
        # each side of a base that is 2 m wide rolls 1 m for 1 rad
        rolled, turned = np.array(self._distance_m), np.array(self._angle_rad)
        weight = Pose(1.0, 1.0, 1.0, 1.0)
        asked = Measure(self._asked.quantity, rolled - turned, rolled + turned, pose, weight)
        try:
            found = fit([asked], _TRACK_M, ("scale",) if straight else ("track",)).factors
        except BadData as error:
            return Found(End.ABORTED, why=str(error))
        return Found(End.SUCCEEDED, found.left if straight else found.track)
