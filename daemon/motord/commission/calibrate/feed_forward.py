# SPDX-License-Identifier: Apache-2.0
"""Feed-forward of wheels whose speed motord controls: the model of the wheel (`tune.fit`) from the
ramps of `duty`, as keys of the robot file. For a duty, dead band and speed at duty 1 come from the
steady speeds, which are more exact; the ramps give the gain for the acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from motord.api.snapshot import Snapshot
from motord.commission.robot_file_edit import KeyPath
from motord.commission.tune.fit import Plant, identify
from motord.commission.tune.procedure import run_of
from motord.config import Robot
from motord.config.sections.joint.speed_loop import CoreGain, SpeedLoop
from motord.config.sections.joint.wheels import gains_of, takes_duty

FASTEST = 4
"""How many runs are used, from the fastest on; slow runs are mostly friction."""


def plants_of(robot: Robot, runs: Sequence[tuple[Snapshot, ...]]) -> dict[str, Plant]:
    """Return the model of each measured wheel whose speed motord can control. Raises Failed."""
    places, found = list(robot.joint), {}
    for name, joint in robot.joint.items():
        profile = robot.profiles[joint.drive]
        if gains_of(joint, profile):
            duty = takes_duty(joint, profile)
            own = [run_of(run, places.index(name), duty=duty) for run in runs[-FASTEST:]]
            found[name] = identify(name, own)
    return found


def plant_changes(robot: Robot, plants: Mapping[str, Plant]) -> dict[KeyPath, Any]:
    """Return keys of [joint.NAME.speed_loop]; a value that it already has is no change."""
    return {
        ("joint", name, "speed_loop", key): value
        for name, plant in plants.items()
        for key, (before, value) in _values(robot, name, plant).items()
        if before != value
    }


def plant_words(robot: Robot, plants: Mapping[str, Plant]) -> list[str]:
    """Return texts with the values before and after, and the residual."""
    return [
        f"{name}: "
        + ", ".join(f"{k} {was:g} \u2192 {value:g}" for k, (was, value) in keys.items())
        + f" (time constant {plant.time_constant_s:.3f} s, off by {plant.misfit_rad_s:.3f} rad/s)"
        for name, plant in plants.items()
        for keys in [_values(robot, name, plant)]
    ]


def _values(robot: Robot, name: str, plant: Plant) -> dict[str, tuple[float, float]]:
    """Return the values before and after, by key, rounded as in the file."""
    joint = robot.joint[name]
    has = joint.speed_loop or SpeedLoop()
    parts: dict[CoreGain, float] = {
        "static_u": plant.static_u,
        "viscous_u_s_per_rad": plant.viscous_u_s_per_rad,
        "acceleration_u_s2_per_rad": plant.acceleration_u_s2_per_rad,
    }
    return {
        key: (getattr(has, key), float(f"{parts[core]:.4g}"))
        for key, core in gains_of(joint, robot.profiles[joint.drive]).items()
        if core in parts
    }
