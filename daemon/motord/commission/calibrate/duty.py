# SPDX-License-Identifier: Apache-2.0
"""Dead band and feed-forward of wheels whose drives take a duty: a line through measured speeds.

duty = dead band + speed / full-duty speed · (1 − dead band), the inverse of which is wheel_duty in
csrc/core/kinematics/wheel.h. Static friction is the dead band, and viscous friction with back-EMF
is the slope."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from motord.api.snapshot import Snapshot
from motord.client import Client
from motord.commission.person import Failed, Person
from motord.commission.robot_file_edit import KeyPath
from motord.commission.session import armed
from motord.config import Robot
from motord.config.sections.joint.wheels import all_reverse, takes_duty, takes_torque

OWNER = "motord-calibrate"
LEVELS = (0.15, 0.25, 0.35, 0.5, 0.65, 0.8)
"""Speeds of the runs, as parts of the greatest speed."""
LOOK_EVERY_S = 0.01
HOLD_S, STEADY_S = 2.5, 0.8
"""Time for which each level is held, and the part at its end that is measured."""
STANDS_RAD_S = 0.1
POINTS_MIN = 4
MISFIT_MAX = 0.05
"""Greatest root mean square of the residuals of a line, as a part of the greatest speed."""


@dataclass(frozen=True, slots=True)
class Point:
    """A steady state of a wheel."""

    duty: float
    velocity_rad_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DutyFit:
    """The fitted line of one wheel."""

    dead_band: float
    dead_band_deviation: float
    full_duty_rad_s: float
    full_duty_deviation_rad_s: float
    misfit_rad_s: float
    points: tuple[Point, ...]


def fit_duty(name: str, points: Sequence[Point]) -> DutyFit:
    """Fit |speed| over |duty| by least squares, both directions as one. Raises Failed."""
    moving = [each for each in points if abs(each.velocity_rad_s) > STANDS_RAD_S]
    if len(moving) < POINTS_MIN:
        raise Failed(
            f"{name}: turned at {len(moving)} of {len(points)} levels, {POINTS_MIN} are needed: "
            "allow more speed (--speed-m-s), or charge the battery"
        )
    if any(each.duty * each.velocity_rad_s < 0.0 for each in moving):
        raise Failed(f"{name}: turned against its duty: motord spin first")
    duty = np.abs([each.duty for each in moving])
    speed = np.abs([each.velocity_rad_s for each in moving])
    design = np.stack([duty, np.ones_like(duty)], axis=1)
    (slope, offset), *_ = np.linalg.lstsq(design, speed, rcond=None)
    residuals = speed - design @ np.array([slope, offset])
    misfit = math.sqrt(float(residuals @ residuals) / (len(moving) - 2))
    if slope <= 0.0 or misfit > MISFIT_MAX * float(np.max(speed)):
        raise Failed(
            f"{name}: its speed does not rise evenly with the duty (off by {misfit:.2f} rad/s): "
            "the floor slopes, a wheel slips, or the battery sags: repeat on level ground"
        )
    dead_band = -offset / slope
    if not 0.0 <= dead_band < 0.9:
        raise Failed(f"{name}: the dead band would be {dead_band:.3f}: repeat on level ground")
    covariance = np.linalg.inv(design.T @ design) * misfit**2
    pull = np.array([offset / slope**2, -1.0 / slope])
    return DutyFit(
        dead_band=float(dead_band),
        dead_band_deviation=math.sqrt(float(pull @ covariance @ pull)),
        full_duty_rad_s=float(slope + offset),
        full_duty_deviation_rad_s=math.sqrt(float(covariance.sum())),
        misfit_rad_s=misfit,
        points=tuple(moving),
    )


def duty_joints(robot: Robot, *, torque: bool = False) -> list[str]:
    """Return the joints whose drives take a duty or, with `torque`, a torque. Raises Failed if
    there is no such joint."""
    profiles = robot.profiles
    found = [
        name
        for name, joint in robot.joint.items()
        if takes_duty(joint, profiles[joint.drive])
        or (torque and takes_torque(joint, profiles[joint.drive]))
    ]
    if not found:
        drives = ", ".join(sorted({joint.drive for joint in robot.joint.values()}))
        if any(takes_torque(joint, profiles[joint.drive]) for joint in robot.joint.values()):
            raise Failed(f"{drives}: takes a torque and no duty: motord calibrate feedforward")
        raise Failed(
            f"{drives}: holds the wheel's speed by itself: it has no dead band and no feed-forward "
            "that motord could set"
        )
    return found


def drive_levels(
    client: Client, person: Person, robot: Robot, speed_m_s: float
) -> list[tuple[Snapshot, ...]]:
    """Drive short straight runs forward and back, at rising speeds, each from rest to rest. Raises
    Failed, Aborted."""
    reverses = all_reverse(robot)
    if not person.confirm(_question(speed_m_s, reverses=reverses)):
        raise Failed("nothing was driven")
    found = []
    with armed(client, person, OWNER) as session:
        session.look_every_s = LOOK_EVERY_S
        for number, level in enumerate(LEVELS, 1):
            for sign in (1.0, -1.0) if reverses else (1.0,):
                person.progress(f"level {number} of {len(LEVELS)}")
                held = session.hold(sign * level * speed_m_s, 0.0, HOLD_S)
                if held.faults:
                    raise Failed(f"{session.stopped_by(held.faults)}: motord spin --all")
                found.append(held.snapshots)
    return found


def duty_fits(robot: Robot, runs: Sequence[Sequence[Snapshot]]) -> dict[str, DutyFit]:
    """Return the fit of each joint that takes a duty. Raises Failed."""
    places, profiles = list(robot.joint), robot.profiles
    return {
        name: fit_duty(name, [steady(run, places.index(name)) for run in runs])
        for name, joint in robot.joint.items()
        if takes_duty(joint, profiles[joint.drive])
    }


def _question(speed_m_s: float, *, reverses: bool) -> str:
    steps_m = [speed_m_s * level * HOLD_S * 1.3 for level in LEVELS]
    how = (
        f"{len(LEVELS)} times forward and back by up to {steps_m[-1]:.1f} m"
        if reverses
        else f"forward by up to {sum(steps_m):.1f} m, with {len(LEVELS)} stops"
    )
    return (
        f"The robot drives {how}, with at most {speed_m_s:g} m/s, on level ground. "
        "Is the path clear?"
    )


def steady(snapshots: Sequence[Snapshot], index: int) -> Point:
    """Return the mean over the end of the time for which the set-point was held. Raises Failed."""
    wanted = [abs(each.joints[index].setpoint_rad_s) for each in snapshots]
    if not max(abs(each.joints[index].duty) for each in snapshots) > 0.0:
        raise Failed("a wheel got no duty: the robot file or a limit keeps it at rest")
    held = [n for n, want in enumerate(wanted) if want > 0.999 * max(wanted)]
    end_ns = snapshots[held[-1]].stamp_ns
    window = [snapshots[n] for n in held if snapshots[n].stamp_ns > end_ns - STEADY_S * 1e9]
    duty = sum(each.joints[index].duty for each in window) / len(window)
    places = {_fed_s(each, index): each.joints[index].position_rad for each in window}
    if max(places) - min(places) > 0.5 * STEADY_S and all(map(math.isfinite, places.values())):
        return Point(duty, _slope(places))  # a counter is more exact than a speed
    velocities = [each.joints[index].velocity_rad_s for each in window]
    if not all(map(math.isfinite, velocities)):
        raise Failed("a wheel measures neither position nor velocity: it cannot be calibrated")
    return Point(duty, sum(velocities) / len(velocities))


def _slope(places: Mapping[float, float]) -> float:
    """Return the median of the slopes of all pairs (Theil-Sen: Sen, Journal of the American
    Statistical Association 63, 1968): a late reply has the position of an earlier moment, and must
    not distort the speed. Pairs that are close in time are left out, since they show little."""
    times_s, angles_rad = np.array(list(places)), np.array(list(places.values()))
    first, second = np.triu_indices(len(times_s), 1)
    apart_s = times_s[second] - times_s[first]
    far = np.abs(apart_s) > 0.25 * STEADY_S
    slopes = (angles_rad[second] - angles_rad[first])[far] / apart_s[far]
    return float(np.median(slopes))


def _fed_s(snapshot: Snapshot, index: int) -> float:
    """Return when the feedback that has a wheel's position was received."""
    return snapshot.stamp_ns * 1e-9 - snapshot.joints[index].feedback_age_s


def duty_changes(
    robot: Robot, fits: Mapping[str, DutyFit], *, feed_forward: bool
) -> dict[KeyPath, Any]:
    """Return keys of the robot file. Without `feed_forward` a given speed at duty 1 stays."""
    found: dict[KeyPath, Any] = {}
    for name, fit in fits.items():
        found["joint", name, "duty_dead_band"] = round(fit.dead_band, 4)
        if feed_forward or robot.joint[name].full_duty_rad_s is None:
            found["joint", name, "full_duty_rad_s"] = round(fit.full_duty_rad_s, 3)
    return found


def duty_words(robot: Robot, fits: Mapping[str, DutyFit]) -> list[str]:
    """Return texts with the values before and after."""
    return [
        f"{name}: dead band {robot.joint[name].duty_dead_band:.4f} → {fit.dead_band:.4f} "
        f"± {fit.dead_band_deviation:.4f}, speed at duty 1 "
        f"{robot.joint[name].full_duty_rad_s or math.nan:.2f} → {fit.full_duty_rad_s:.2f} "
        f"± {fit.full_duty_deviation_rad_s:.2f} rad/s ({len(fit.points)} points, "
        f"off by {fit.misfit_rad_s:.3f} rad/s)"
        for name, fit in fits.items()
    ]
