# SPDX-License-Identifier: Apache-2.0
"""Write parameters that were set while the robot ran to its robot file."""

from __future__ import annotations

import math
from collections.abc import Mapping

from motord.commission.person import Failed
from motord.commission.robot_file_edit import RobotFileEdit
from motord.config import Robot
from motord.config.sections.joint.limits import NUMBERS, JointLimits
from motord.config.sections.joint.speed_loop import SpeedLoop

LIMITS, JOINT = "limits.", "joint."
_ROUNDS = 2
"""Passes over the values; a value that the file does not give may follow from another one."""


def put_in_force(edit: RobotFileEdit, in_force: Mapping[str, float | None]) -> dict[str, float]:
    """Add to the file those limits and gains in force that it does not have; returns them by name.
    `in_force`: the answer of `params.get`; None: no limit. Raises ConfigError, Failed."""
    wanted = {name: math.inf if value is None else value for name, value in in_force.items()}
    if other := [name for name in wanted if not name.startswith((LIMITS, JOINT))]:
        raise Failed(
            f"{other[0]}: is a register of a drive, and the robot file holds none: store it in the "
            "drive with its maker's tool"
        )
    put: dict[str, float] = {}
    for _ in range(_ROUNDS):
        for name, value in _differing(edit.checked(), wanted).items():
            edit.set(tuple(name.split(".")), value)
            put[name] = value
    if left := _differing(edit.checked(), wanted):
        raise Failed(f"{', '.join(left)}: the file does not take the value in force")
    return put


def _differing(robot: Robot, wanted: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in wanted.items() if _of_file(robot, name) != value}


def _of_file(robot: Robot, name: str) -> float:
    *_, key = name.split(".")
    if name.startswith(LIMITS):
        return float(getattr(robot.limits, key))
    _, joint, *_ = name.split(".")
    if key in NUMBERS:
        return float(getattr(JointLimits.of(robot.joint[joint]), key))
    return float(getattr(robot.joint[joint].speed_loop or SpeedLoop(), key))
