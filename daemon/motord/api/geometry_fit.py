# SPDX-License-Identifier: Apache-2.0
"""Wheel radii and track that explain what was measured on the floor: weighted nonlinear least
squares (Gauss-Newton) over recorded paths of the wheels.

A path is what each side has rolled by the present radii. The true base has rolled `left` and
`right` times as much, on `track` times the track. What a square shows and a straight line does not
is why it is driven in both directions: Borenstein & Feng, UMBmark, University of Michigan, 1994,
and Measurement and Correction of Systematic Odometry Errors in Mobile Robots, IEEE Transactions on
Robotics and Automation 12(6), 1996."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Free = Literal["scale", "ratio", "track"]
"""Of the three unknowns: both radii together, right over left, the track."""
FREE: tuple[Free, ...] = ("scale", "ratio", "track")
FACTOR_MIN, FACTOR_MAX = 0.8, 1.25
"""A factor beyond is no error of measure, but another distance than the one that was named."""
MISFIT_MAX = 5.0
"""Root mean square of the residuals, in their own deviations: more is slip, or a wrong number."""
_ITERATIONS = 30
_STEP = 1e-6
_CONVERGED = 1e-10
_RANK = 1e-6
"""Least singular value over the greatest, of the scaled Jacobian."""


class BadData(ValueError):
    """The measures cannot give a result; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Factors:
    """What the present radii and the present track are to be multiplied by."""

    left: float = 1.0
    right: float = 1.0
    track: float = 1.0


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a path ends, from its start; NaN in a measure: not measured."""

    x_m: float = math.nan
    y_m: float = math.nan
    heading_rad: float = math.nan
    """All turns counted, no wrap."""
    distance_m: float = math.nan
    """Along the path; negative backward."""

    def values(self) -> Array:
        """In this order."""
        return np.array([self.x_m, self.y_m, self.heading_rad, self.distance_m])


@dataclass(frozen=True, slots=True)
class Measure:
    """One path with what was measured at its end. `deviation`: how exact the measure is."""

    name: str
    left_m: Array
    """Rolled by the left side so far, by the present radius; from 0 on."""
    right_m: Array
    found: Pose
    deviation: Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """The result, with how well it is known."""

    factors: Factors
    deviations: Factors
    """Standard deviations of the factors; 0: was not free."""
    residuals: tuple[Pose, ...]
    """Measured minus predicted, of each measure."""
    residuals_before: tuple[Pose, ...]
    """The same with the present geometry."""
    misfit: float
    """Root mean square of the residuals in their deviations; NaN: nothing is left over."""


def end_pose(left_m: Array, right_m: Array, track_m: float, factors: Factors) -> Pose:
    """Where the base ends: an exact arc between two samples, as csrc/core/odometry.c has it."""
    left, right = np.diff(left_m) * factors.left, np.diff(right_m) * factors.right
    forward, turn = (left + right) / 2.0, (right - left) / (track_m * factors.track)
    middle = np.cumsum(turn) - turn / 2.0
    chord = forward * np.sinc(turn / (2.0 * math.pi))
    return Pose(
        float(np.sum(chord * np.cos(middle))),
        float(np.sum(chord * np.sin(middle))),
        float(np.sum(turn)),
        float(np.sum(forward)),
    )


def fit(
    measures: Sequence[Measure], track_m: float, free: Sequence[Free], *, robust: bool = False
) -> Fit:
    """The factors that explain all measures best. `robust`: the deviations follow from how the
    residuals of the measures scatter (clustered sandwich estimator: Liang & Zeger, Biometrika
    73(1), 1986), not from the deviations that were given; for logs with unknown slip. Raises
    BadData."""
    start = np.zeros(len(free))
    found = _solved(measures, track_m, free, start)
    factors = _factors(found, free)
    if not all(FACTOR_MIN <= one <= FACTOR_MAX for one in (factors.left, factors.right)) or (
        not FACTOR_MIN <= factors.track <= FACTOR_MAX
    ):
        raise BadData(
            f"the factors would be {factors.left:.3g} (left), {factors.right:.3g} (right) and "
            f"{factors.track:.3g} (track), too far from 1 for an error of measure: was each "
            "distance the one that was named, and are the radii of the file about right?"
        )
    residuals = _residuals(measures, track_m, free, found)
    left_over = residuals.size - len(free)
    misfit = math.sqrt(float(residuals @ residuals) / left_over) if left_over > 0 else math.nan
    if misfit > MISFIT_MAX and not robust:
        worst = _poses(measures, track_m, factors)
        raise BadData(f"the measures contradict each other: {_worst(measures, worst)}: {_CAUSES}")
    covariance = _covariance(measures, track_m, free, found, misfit, robust=robust)
    return Fit(
        factors=factors,
        deviations=_deviations(covariance, factors, free),
        residuals=_poses(measures, track_m, factors),
        residuals_before=_poses(measures, track_m, Factors()),
        misfit=misfit,
    )


_CAUSES = "a wheel has slipped, a number is wrong, or the robot was moved: repeat this run"


def _solved(measures: Sequence[Measure], track_m: float, free: Sequence[Free], at: Array) -> Array:
    for _ in range(_ITERATIONS):
        residuals = _residuals(measures, track_m, free, at)
        if not np.all(np.isfinite(residuals)):
            raise BadData("a measure or a path is not a finite number")
        jacobian = _jacobian(measures, track_m, free, at)
        singular = np.linalg.svd(jacobian, compute_uv=False)
        if len(singular) < len(free) or singular[-1] < _RANK * max(singular[0], 1e-12):
            raise BadData(f"these runs do not determine {', '.join(free)}: add another kind of run")
        step = np.linalg.lstsq(jacobian, -residuals, rcond=None)[0]
        at = at + step
        if not np.all(np.abs(at) < 1.0):
            raise BadData("no geometry explains these measures: " + _CAUSES)
        if float(np.max(np.abs(step))) < _CONVERGED:
            return at
    raise BadData("no geometry explains these measures: " + _CAUSES)


def _factors(at: Array, free: Sequence[Free]) -> Factors:
    """The unknowns are logarithms, so that no factor can become negative."""
    values = dict.fromkeys(FREE, 0.0) | dict(zip(free, map(float, at), strict=True))
    return Factors(
        math.exp(values["scale"] - values["ratio"] / 2.0),
        math.exp(values["scale"] + values["ratio"] / 2.0),
        math.exp(values["track"]),
    )


def _residuals(
    measures: Sequence[Measure], track_m: float, free: Sequence[Free], at: Array
) -> Array:
    """Predicted minus measured, each in its deviation; what was not measured is left out."""
    return np.concatenate([_one(each, track_m, _factors(at, free)) for each in measures])


def _one(measure: Measure, track_m: float, factors: Factors) -> Array:
    predicted = end_pose(measure.left_m, measure.right_m, track_m, factors).values()
    found = measure.found.values()
    known = ~np.isnan(found)
    off: Array = (predicted - found)[known] / measure.deviation.values()[known]
    return off


def _jacobian(
    measures: Sequence[Measure], track_m: float, free: Sequence[Free], at: Array
) -> Array:
    columns = []
    for place in range(len(free)):
        step = np.zeros(len(free))
        step[place] = _STEP
        ahead = _residuals(measures, track_m, free, at + step)
        behind = _residuals(measures, track_m, free, at - step)
        columns.append((ahead - behind) / (2.0 * _STEP))
    return np.stack(columns, axis=1)


def _covariance(
    measures: Sequence[Measure], track_m: float, free: Sequence[Free], at: Array, misfit: float,
    *, robust: bool,
) -> Array:  # fmt: skip
    jacobian = _jacobian(measures, track_m, free, at)
    bread = np.linalg.inv(jacobian.T @ jacobian)
    if not robust:
        worse = max(1.0, misfit) if math.isfinite(misfit) else 1.0
        scaled: Array = (bread * worse**2).astype(np.float64)
        return scaled
    meat = np.zeros_like(bread)
    for each in measures:
        rows = _jacobian([each], track_m, free, at)
        pull = rows.T @ _one(each, track_m, _factors(at, free))
        meat += np.outer(pull, pull)
    count = len(measures)
    if count <= len(free):
        raise BadData("the log is too short: more than three metres of path are needed")
    spread: Array = bread @ meat @ bread * (count / (count - len(free)))
    return spread


def _deviations(covariance: Array, factors: Factors, free: Sequence[Free]) -> Factors:
    """d left = left (d scale − d ratio / 2), and so on."""
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


def _poses(measures: Sequence[Measure], track_m: float, factors: Factors) -> tuple[Pose, ...]:
    """Measured minus predicted."""
    return tuple(
        Pose(
            *(
                each.found.values() - end_pose(each.left_m, each.right_m, track_m, factors).values()
            ).tolist()
        )
        for each in measures
    )


def _worst(measures: Sequence[Measure], residuals: Sequence[Pose]) -> str:
    """The measure that is furthest off, in words."""

    def badness(place: int) -> float:
        off = residuals[place].values() / measures[place].deviation.values()
        return float(np.nanmax(np.abs(off)))

    place = max(range(len(measures)), key=badness)
    off = residuals[place]
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
    return f'"{measures[place].name}" is off by {", ".join(parts)}'
