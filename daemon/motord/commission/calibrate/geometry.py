# SPDX-License-Identifier: Apache-2.0
"""Convert a fit of the geometry to keys of the robot file and to texts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from motord.api.geometry_fit import Fit, Free, Measure, Pose
from motord.commission.person import Failed
from motord.commission.robot_file_edit import KeyPath
from motord.config import Robot
from motord.config.sections.bases import JointsBase, SkidBase, TwoSidedBase, side_of

_FREE_OF: Mapping[str, tuple[Free, ...]] = {
    "straight": ("scale", "ratio"),
    "rotate": ("track",),
    "square": ("ratio", "track"),
    "all": ("scale", "ratio", "track"),
    "log": ("scale", "ratio", "track"),
}
"""Unknowns that each kind of run determines."""
_DIGITS = 6
"""Digits after the point: radii and track are rounded to a micrometre."""


def free_of(robot: Robot, what: str) -> tuple[Free, ...]:
    """Return the unknowns that this kind of run determines. Raises Failed for a base that the fit
    does not describe."""
    base = robot.base
    if isinstance(base, TwoSidedBase):
        return _FREE_OF[what]
    if isinstance(base, JointsBase):
        raise Failed(f'{robot.path}: base.kind: "joints" is no base that drives: nothing was moved')
    if what == "straight":
        return ("scale",)
    raise Failed(
        f"{robot.path}: base.kind: both radii and the track are fitted for bases with wheels on "
        f"two sides, not for {base.kind}: measure its sizes with a tape, and its wheels' radius "
        "with motord calibrate straight; nothing was moved"
    )


def require_same(robot: Robot, described: Mapping[str, Any]) -> None:
    """Check that the daemon runs with this file's radii and track. Raises Failed."""
    ours = {name: robot.wheel_radius_m(name) for name in robot.joint}
    theirs = described["wheel_radii_m"]
    if ours != theirs or robot.base.effective_track_m != described["effective_track_m"]:
        raise Failed(
            f"{robot.path}: has other radii or another track than the running daemon: start the "
            "daemon again with this file and without --set of these keys"
        )


def changes(robot: Robot, fit: Fit, free: Sequence[Free]) -> dict[KeyPath, Any]:
    """Return the changed keys of the robot file."""
    if not isinstance(robot.base, TwoSidedBase):
        return _radius_changes(robot, fit.factors.left)
    found: dict[KeyPath, Any] = {}
    factors = {"left": fit.factors.left, "right": fit.factors.right}
    if "scale" in free or "ratio" in free:
        radii = {
            name: round(robot.wheel_radius_m(name) * factors[side_of(robot.base, joint)], _DIGITS)
            for name, joint in robot.joint.items()
        }
        found["base", "wheel_radius_m"] = round(sum(radii.values()) / len(radii), _DIGITS)
        for name, radius_m in radii.items():
            found["joint", name, "wheel_radius_m"] = radius_m
    if "track" in free:
        base = robot.base
        slip = base.track_slip_factor * fit.factors.track if isinstance(base, SkidBase) else 0.0
        if slip >= 1.0:
            found["base", "track_slip_factor"] = round(slip, _DIGITS)
        else:
            found["base", "track_m"] = round(base.track_m * fit.factors.track, _DIGITS)
    return found


def _radius_changes(robot: Robot, factor: float) -> dict[KeyPath, Any]:
    """Return the keys of the wheel radii, all multiplied by one factor."""
    found: dict[KeyPath, Any] = {
        ("base", "wheel_radius_m"): round(robot.base.wheel_radius_m * factor, _DIGITS)
    }
    for name, joint in robot.joint.items():
        if joint.wheel_radius_m is not None:
            found["joint", name, "wheel_radius_m"] = round(joint.wheel_radius_m * factor, _DIGITS)
    return found


def words(robot: Robot, fit: Fit, measures: Sequence[Measure]) -> Iterator[str]:
    """Return texts with the values before and after, and the residuals of each measure."""
    if isinstance(robot.base, TwoSidedBase):
        yield from _two_sided_rows(robot, fit)
    else:
        radius_m = robot.base.wheel_radius_m
        yield _row("wheel radius", radius_m, fit.factors.left, fit.deviations.left)
    rows = zip(measures, fit.residuals_before, fit.residuals, strict=True)
    for measure, before, after in rows if len(measures) <= _ROWS_MAX else ():
        yield f"{measure.name}: off by {_pose(before)} before, {_pose(after)} after"
    if not math.isnan(fit.misfit):
        yield f"misfit {fit.misfit:.2f} (1: as exact as a tape; more than 5 is refused)"


_ROWS_MAX = 12


def _two_sided_rows(robot: Robot, fit: Fit) -> Iterator[str]:
    sides = {side_of(robot.base, joint): name for name, joint in robot.joint.items()}
    for side in ("left", "right"):
        before_m = robot.wheel_radius_m(sides[side])
        factor, deviation = getattr(fit.factors, side), getattr(fit.deviations, side)
        yield _row(f"wheel radius {side}", before_m, factor, deviation)
    yield _row("track", robot.base.effective_track_m, fit.factors.track, fit.deviations.track)


def _row(name: str, before_m: float, factor: float, deviation: float) -> str:
    if not deviation:
        return f"{name}: {before_m * 1e3:.2f} mm (not measured)"
    return (
        f"{name}: {before_m * 1e3:.2f} mm → {before_m * factor * 1e3:.2f} mm "
        f"± {before_m * deviation * 1e3:.2f} mm ({100 * (factor - 1.0):+.2f} %)"
    )


def _pose(off: Pose) -> str:
    parts = [
        f"{off.x_m * 1e3:+.0f} mm along" if math.isfinite(off.x_m) else "",
        f"{off.y_m * 1e3:+.0f} mm sideways" if math.isfinite(off.y_m) else "",
        f"{math.degrees(off.heading_rad):+.1f}°" if math.isfinite(off.heading_rad) else "",
    ]
    return ", ".join(part for part in parts if part)
