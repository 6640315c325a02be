# SPDX-License-Identifier: Apache-2.0
"""Plots of a calibration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from motord.api.geometry_fit import Array, Factors, Fit, Measure
from motord.commission.calibrate.duty import DutyFit
from motord.commission.calibrate.procedure import Calibration
from motord.commission.page.pictures import Plot, Style, axis, plain, series
from motord.config import Robot

POINTS_MAX = 200
"""Greatest number of points of a path in a plot."""


def pictures(robot: Robot, found: Calibration) -> Iterator[Plot]:
    """Return the plots of a calibration."""
    if found.fit is not None:
        yield _paths(found.measures, robot.base.effective_track_m, found.fit)
        yield from _misses(found.measures, found.fit)
    if found.duty:
        yield _duty(robot, found.duty)
        yield _duty_residuals(found.duty)


# --------------------------------------------------------------------------------------- geometry
def path(measure: Measure, track_m: float, factors: Factors) -> tuple[Array, Array]:
    """Return the path of the base by its wheels: x and y, exact for arcs to the second order."""
    left = np.diff(measure.left_m) * factors.left
    right = np.diff(measure.right_m) * factors.right
    turn = (right - left) / (track_m * factors.track)
    middle = np.cumsum(turn) - turn / 2.0
    forward = (left + right) / 2.0
    return np.cumsum(forward * np.cos(middle)), np.cumsum(forward * np.sin(middle))


def _paths(measures: Sequence[Measure], track_m: float, fit: Fit) -> Plot:
    rows = []
    geometries: tuple[tuple[str, Style, Factors], ...] = (
        ("before", "dashed", Factors()), ("after", "line", fit.factors),
    )  # fmt: skip
    for when, style, factors in geometries:
        for measure in measures:
            rolled = path(measure, track_m, factors)
            every = max(1, math.ceil(len(rolled[0]) / POINTS_MAX))
            points = [[*part[::every], part[-1]] for part in rolled]
            rows.append(series(f"{measure.name}, {when}", style, *points))
    ends = [measure.found for measure in measures if math.isfinite(measure.found.x_m)]
    if ends:
        x_m, y_m = ([getattr(end, part) for end in ends] for part in ("x_m", "y_m"))
        rows.append(series("measured on the floor", "crosses", x_m, y_m))
    axes = {"x": axis("forward", "m"), "y": axis("to the left", "m")}
    return {"title": "Paths by the wheels", **axes, "equal": True, "series": rows}


def _misses(measures: Sequence[Measure], fit: Fit) -> Iterator[Plot]:
    """Return plots of the distances between the end of each path and where it was measured."""
    when = (("before", fit.residuals_before), ("after", fit.residuals))
    parts = (("x_m", "along", 1e3, "mm"), ("y_m", "sideways", 1e3, "mm"),
             ("heading_rad", "heading", math.degrees(1.0), "°"))  # fmt: skip
    for part, title, scale, unit in parts:
        rows = {name: [scale * getattr(off, part) for off in offs] for name, offs in when}
        if not any(math.isfinite(value) for row in rows.values() for value in row):
            continue
        yield {
            "bars": [measure.name for measure in measures],
            "title": f"Off by, {title}",
            "y": axis(title, unit),
            "series": [{"title": name, "y": plain(row)} for name, row in rows.items()],
        }


# ------------------------------------------------------------------------------------------- duty
def _duty(robot: Robot, fits: Mapping[str, DutyFit]) -> Plot:
    rows = []
    for name, fit in fits.items():
        points = sorted((abs(each.duty), abs(each.velocity_rad_s)) for each in fit.points)
        rows.append(series(f"{name}, measured", "points", *zip(*points, strict=True)))
        joint, most = robot.joint[name], points[-1][0]
        if joint.full_duty_rad_s is not None:
            before = _line(joint.duty_dead_band, joint.full_duty_rad_s, most)
            rows.append(series(f"{name}, before", "dashed", *before))
        after = _line(fit.dead_band, fit.full_duty_rad_s, most)
        rows.append(series(f"{name}, after", "line", *after))
    axes = {"x": axis("duty", "1"), "y": axis("speed of the wheel", "rad/s")}
    return {"title": "Speed over duty", **axes, "series": rows}


def _line(dead_band: float, full_duty_rad_s: float, most: float) -> tuple[list[float], list[float]]:
    """Return the line of motord.commission.calibrate.duty: duties and speeds."""
    duties = [dead_band, max(dead_band, most)]
    return duties, [full_duty_rad_s * (duty - dead_band) / (1.0 - dead_band) for duty in duties]


def _duty_residuals(fits: Mapping[str, DutyFit]) -> Plot:
    rows = []
    for name, fit in fits.items():
        slope_rad_s = fit.full_duty_rad_s / (1.0 - fit.dead_band)
        left_over = sorted(
            (
                abs(each.duty),
                abs(each.velocity_rad_s) - slope_rad_s * (abs(each.duty) - fit.dead_band),
            )
            for each in fit.points
        )
        rows.append(series(name, "points", *zip(*left_over, strict=True)))
    axes = {"x": axis("duty", "1"), "y": axis("measured minus line", "rad/s")}
    return {"title": "What the line leaves over", **axes, "series": rows}
