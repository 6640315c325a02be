# SPDX-License-Identifier: Apache-2.0
"""A calibration, from the first question to the changed keys; the caller writes the file. Needs
numpy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from motord.api.geometry_fit import Fit, Free, Measure, fit
from motord.client import Client
from motord.commission.calibrate.duty import (
    DutyFit,
    drive_levels,
    duty_changes,
    duty_fits,
    duty_joints,
    duty_words,
)
from motord.commission.calibrate.feed_forward import plant_changes, plant_words, plants_of
from motord.commission.calibrate.geometry import changes, free_of, require_same, words
from motord.commission.calibrate.gyro import GyroFound, gyro_changes, measure_gyro
from motord.commission.calibrate.runs import Runs
from motord.commission.person import Person
from motord.commission.robot_file_edit import RobotFileEdit
from motord.commission.tune.fit import Plant
from motord.config import Robot
from motord.config.sections.joint.wheels import takes_duty, takes_torque

GEOMETRY = ("straight", "rotate", "square")


@dataclass(slots=True)
class Calibration:
    """The measured values; None or empty: this was not measured."""

    measures: list[Measure] = field(default_factory=list)
    fit: Fit | None = None
    duty: Mapping[str, DutyFit] = field(default_factory=dict)
    plants: Mapping[str, Plant] = field(default_factory=dict)
    gyro: GyroFound | None = None


def calibrated(
    client: Client, person: Person, edit: RobotFileEdit, what: str, options: Mapping[str, float]
) -> Calibration:
    """Move, measure, show, and give `edit` the new values. `what`: a kind of `motord calibrate`;
    `options`: those of motord.api.procedures. Raises Aborted, Failed, BadData, ClientError."""
    robot, found = edit.before, Calibration()
    require_same(robot, client.call("robot"))
    if what in (*GEOMETRY, "all"):
        free = free_of(robot, what)
        runs = Runs(client, person, options)
        kinds = GEOMETRY if what == "all" else (what,)
        found.measures = [measure for kind in kinds for measure in getattr(runs, kind)()]
        found.fit = fitted(person, edit, free, found.measures)
    if what in ("deadband", "feedforward") or (what == "all" and _holds_speed(robot)):
        duty_joints(robot, torque=what != "deadband")  # raises before anything moves
        levels = drive_levels(client, person, robot, options["speed_m_s"])
        found.duty = duty_fits(robot, levels)
        found.plants = {} if what == "deadband" else plants_of(robot, levels)
        for text in (*duty_words(robot, found.duty), *plant_words(robot, found.plants)):
            person.show(text)
        edit.update(duty_changes(robot, found.duty, feed_forward=what != "deadband"))
        edit.update(plant_changes(robot, found.plants))
    if what == "gyro":
        gyro = measure_gyro(client, person, robot, options["turns"], options["speed_rad_s"])
        person.show(
            f"gyro: offset {gyro.bias_rad_s:+.5f} rad/s, scale {gyro.scale:.4f} "
            f"± {gyro.difference:.4f}; the robot file holds the variance that follows"
        )
        edit.update(gyro_changes(gyro))
        found.gyro = gyro
    return found


def fitted(
    person: Person,
    edit: RobotFileEdit,
    free: tuple[Free, ...],
    measures: Sequence[Measure],
    *,
    robust: bool = False,
) -> Fit:
    """Find the radii and track that explain the measures best; show them and give them to `edit`.
    Raises BadData."""
    robot = edit.before
    found = fit(measures, robot.base.effective_track_m, free, robust=robust)
    for text in words(robot, found, measures):
        person.show(text)
    edit.update(changes(robot, found, free))
    return found


def _holds_speed(robot: Robot) -> bool:
    """Whether a drive takes a duty or a torque."""
    profiles = robot.profiles
    return any(
        takes(joint, profiles[joint.drive])
        for joint in robot.joint.values()
        for takes in (takes_duty, takes_torque)
    )
