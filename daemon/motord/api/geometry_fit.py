# SPDX-License-Identifier: Apache-2.0
"""Wheel radii and track that explain what was measured on the floor: weighted nonlinear least
squares (Gauss-Newton) over recorded paths of the wheels.

A path is the distance that each side has rolled, computed with the present radii. The true base has
rolled `left` and `right` times as much, on `track` times the track. A square is driven in both
directions because it shows errors that a straight line does not: Borenstein & Feng, UMBmark,
University of Michigan, 1994, and Measurement and Correction of Systematic Odometry Errors in Mobile
Robots, IEEE Transactions on Robotics and Automation 12(6), 1996."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Free = Literal["scale", "ratio", "track"]
"""Name of an unknown: the factor of both radii, the ratio of right to left radius, the track."""
FREE: tuple[Free, ...] = ("scale", "ratio", "track")
FACTOR_MIN, FACTOR_MAX = 0.8, 1.25
"""Range of a factor. Outside it a distance was given wrong; no error of measurement is as great."""
MISFIT_MAX = 5.0
"""Greatest root mean square of the residuals, each divided by its standard deviation; a greater one
means slip, or a wrong number."""
_ITERATIONS = 30
_STEP = 1e-6
_CONVERGED = 1e-10
_RANK = 1e-6
"""Least ratio of the smallest to the greatest singular value of the scaled Jacobian."""


class BadData(ValueError):
    """The measures cannot give a result; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Factors:
    """Factors by which the present radii and the present track are to be multiplied."""

    left: float = 1.0
    right: float = 1.0
    track: float = 1.0


@dataclass(frozen=True, slots=True)
class Pose:
    """End of a path relative to its start; NaN in a measure: not measured."""

    x_m: float = math.nan
    y_m: float = math.nan
    heading_rad: float = math.nan
    """Sum of all turns, not wrapped."""
    distance_m: float = math.nan
    """Length of the path; negative backward."""

    def values(self) -> Array:
        """Return the values in the order of the fields."""
        return np.array([self.x_m, self.y_m, self.heading_rad, self.distance_m])


@dataclass(frozen=True, slots=True)
class Measure:
    """One path with what was measured at its end. `deviation`: standard deviations of `found`."""

    name: str
    left_m: Array
    """Distance rolled by the left side at each sample, with the present radius; begins at 0."""
    right_m: Array
    found: Pose
    deviation: Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """The result of `fit`, with its uncertainty."""

    factors: Factors
    deviations: Factors
    """Standard deviations of the factors; 0: the factor was not free."""
    residuals: tuple[Pose, ...]
    """Measured minus predicted, of each measure."""
    residuals_before: tuple[Pose, ...]
    """Measured minus predicted with the present geometry, of each measure."""
    misfit: float
    """Root mean square of the residuals, each divided by its standard deviation; NaN: there are not
    more measured values than unknowns."""


def end_pose(left_m: Array, right_m: Array, track_m: float, factors: Factors) -> Pose:
    """Return the pose in which a base with these wheel paths and factors ends."""
    stack = _Stack([Measure("", left_m, right_m, Pose(), Pose())], track_m)
    return Pose(*stack.ends(factors)[0].tolist())


class _Stack:
    """All measures as arrays with a row each; shorter paths stand still at their end."""

    def __init__(self, measures: Sequence[Measure], track_m: float) -> None:
        longest = max(len(each.left_m) for each in measures) - 1
        self._track_m = track_m
        self._left, self._right = np.zeros((2, len(measures), longest))
        for row, each in enumerate(measures):
            self._left[row, : len(each.left_m) - 1] = np.diff(each.left_m)
            self._right[row, : len(each.right_m) - 1] = np.diff(each.right_m)
        self.found = np.array([each.found.values() for each in measures])
        self.known = ~np.isnan(self.found)
        deviations = np.array([each.deviation.values() for each in measures])
        self._weights = np.where(self.known, 1.0 / deviations, 0.0)

    def ends(self, factors: Factors) -> Array:
        """Return the predicted poses: an exact arc between two samples, as in
        csrc/core/kinematics/odometry.c."""
        left, right = self._left * factors.left, self._right * factors.right
        forward, turn = (left + right) / 2.0, (right - left) / (self._track_m * factors.track)
        middle = np.cumsum(turn, axis=1) - turn / 2.0
        chord = forward * np.sinc(turn / (2.0 * math.pi))
        parts = (chord * np.cos(middle), chord * np.sin(middle), turn, forward)
        return np.stack([part.sum(axis=1) for part in parts], axis=1)

    def off(self, factors: Factors) -> Array:
        """Return predicted minus measured, in standard deviations; 0 for what was not measured."""
        difference = np.where(self.known, self.ends(factors) - self.found, 0.0)
        weighted: Array = difference * self._weights
        return weighted

    def left_over(self, factors: Factors) -> tuple[Pose, ...]:
        """Return measured minus predicted, in metres and radians."""
        return tuple(Pose(*row.tolist()) for row in self.found - self.ends(factors))

    def slopes(self, at: Array, free: Sequence[Free]) -> Array:
        """Return the derivative of `off` with respect to each unknown: measures × 4 × unknowns."""
        columns = []
        for place in range(len(free)):
            step = np.zeros(len(free))
            step[place] = _STEP
            ahead, behind = (self.off(_factors(one, free)) for one in (at + step, at - step))
            columns.append((ahead - behind) / (2.0 * _STEP))
        return np.stack(columns, axis=2)


def fit(
    measures: Sequence[Measure], track_m: float, free: Sequence[Free], *, robust: bool = False
) -> Fit:
    """Return the factors that explain all measures best. `robust`: derive the deviations from the
    scatter of the measures' residuals (clustered sandwich estimator: Liang & Zeger, Biometrika
    73(1), 1986), not from the given deviations; for logs with unknown slip. Raises BadData."""
    stack = _Stack(measures, track_m)
    found = _solved(stack, free)
    factors = _factors(found, free)
    if not all(
        FACTOR_MIN <= one <= FACTOR_MAX for one in (factors.left, factors.right, factors.track)
    ):
        raise BadData(
            f"the factors would be {factors.left:.3g} (left), {factors.right:.3g} (right) and "
            f"{factors.track:.3g} (track), too far from 1 for an error of measurement: "
            "check each distance that you gave, and the radii in the robot file"
        )
    off = stack.off(factors)
    left_over = int(stack.known.sum()) - len(free)
    misfit = math.sqrt(float(np.sum(off**2)) / left_over) if left_over > 0 else math.nan
    residuals = stack.left_over(factors)
    if misfit > MISFIT_MAX and not robust:
        worst = int(np.argmax(np.max(np.abs(off), axis=1)))
        what = f'"{measures[worst].name}" is off by {_words(residuals[worst])}'
        raise BadData(f"the measures contradict each other: {what}: {_CAUSES}")
    covariance = _covariance(stack, free, found, misfit, robust=robust)
    return Fit(
        factors=factors,
        deviations=_deviations(covariance, factors, free),
        residuals=residuals,
        residuals_before=stack.left_over(Factors()),
        misfit=misfit,
    )


_CAUSES = "a wheel has slipped, a number is wrong, or the robot was moved: repeat this run"


def _solved(stack: _Stack, free: Sequence[Free]) -> Array:
    at = np.zeros(len(free))
    for _ in range(_ITERATIONS):
        off = stack.off(_factors(at, free)).ravel()
        if not np.all(np.isfinite(off)):
            raise BadData("a measure or a path is not a finite number")
        slopes = stack.slopes(at, free).reshape(off.size, len(free))
        singular = np.linalg.svd(slopes, compute_uv=False)
        if singular[-1] < _RANK * max(float(singular[0]), 1e-12):
            raise BadData(f"these runs do not determine {', '.join(free)}: add another kind of run")
        step = np.linalg.lstsq(slopes, -off, rcond=None)[0]
        at = at + step
        if not np.all(np.abs(at) < 1.0):
            raise BadData("no geometry explains these measures: " + _CAUSES)
        if float(np.max(np.abs(step))) < _CONVERGED:
            return at
    raise BadData("no geometry explains these measures: " + _CAUSES)


def _factors(at: Array, free: Sequence[Free]) -> Factors:
    """Return the factors of the unknowns, which are logarithms: no factor can become negative."""
    values = dict.fromkeys(FREE, 0.0) | dict(zip(free, map(float, at), strict=True))
    return Factors(
        math.exp(values["scale"] - values["ratio"] / 2.0),
        math.exp(values["scale"] + values["ratio"] / 2.0),
        math.exp(values["track"]),
    )


def _covariance(
    stack: _Stack, free: Sequence[Free], at: Array, misfit: float, *, robust: bool
) -> Array:
    slopes, off = stack.slopes(at, free), stack.off(_factors(at, free))
    bread = np.linalg.inv(np.einsum("nki,nkj->ij", slopes, slopes))
    if not robust:
        worse = max(1.0, misfit) if math.isfinite(misfit) else 1.0
        return np.asarray(bread * worse**2, dtype=np.float64)
    if len(off) <= len(free):
        raise BadData("there are fewer windows than unknowns: a longer log is needed")
    # each residual without its own measure's influence on the result (the jackknife of CR3: Bell &
    # McCaffrey, Survey Methodology 28(2), 2002); otherwise few windows with much turning seem too
    # exact
    identity = np.eye(slopes.shape[1])
    leverage = np.einsum("nki,ij,nlj->nkl", slopes, bread, slopes)
    free_off = np.linalg.solve(identity - leverage, off[:, :, None])[:, :, 0]
    pulls = np.einsum("nki,nk->ni", slopes, free_off)
    return np.asarray(bread @ (pulls.T @ pulls) @ bread, dtype=np.float64)


def _deviations(covariance: Array, factors: Factors, free: Sequence[Free]) -> Factors:
    """Return the standard deviations of the factors, as in d left = left (d scale − d ratio /
    2)."""
    places = {name: place for place, name in enumerate(free)}

    def deviation(factor: float, parts: dict[str, float]) -> float:
        row = np.zeros(len(places))
        for name, part in parts.items():
            if name in places:
                row[places[name]] = part
        return factor * math.sqrt(float(row @ covariance @ row))

    return Factors(
        deviation(factors.left, {"scale": 1.0, "ratio": -0.5}),
        deviation(factors.right, {"scale": 1.0, "ratio": 0.5}),
        deviation(factors.track, {"track": 1.0}),
    )


def _words(off: Pose) -> str:
    parts = [
        f"{value:+.3f} {unit} {words}"
        for value, unit, words in (
            (off.x_m, "m", "along"),
            (off.y_m, "m", "sideways"),
            (off.heading_rad, "rad", "of turn"),
            (off.distance_m, "m", "of path"),
        )
        if math.isfinite(value)
    ]
    return ", ".join(parts)
