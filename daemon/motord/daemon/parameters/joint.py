# SPDX-License-Identifier: Apache-2.0
"""Limits of joints without a base by name: `joint.pan.velocity_max_rad_s` and the like, as in the
robot file. They change while the joints move: a lowered limit is reached by deceleration.

A joint gets no faster than its robot file allows: the checks of its feedback depend on that
speed."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from motord.config import Robot
from motord.config.rules.limits import joint_beyond_file, joint_stops
from motord.config.sections.joint.limits import NUMBERS, JointLimits, limit_keys
from motord.config.sections.section import Number
from motord.daemon.parameters.robot import ask_for_force, refuse_wrong
from motord.local_socket.server import INVALID_PARAMS, RpcError, json_number
from motord_hal.base.nearest import nearest

Limits = Mapping[str, JointLimits]
"""Limits in force by joint."""


def listed(robot: Robot, limits: Limits) -> dict[str, dict[str, Any]]:
    """Return value, unit, range and description of every limit."""
    found = {}
    for name, (joint, key) in _known(robot).items():
        number = _number(robot, joint, key)
        found[name] = {
            "value": json_number(getattr(limits[joint], key)),
            "unit": number.unit,
            "minimum": number.low,
            "maximum": number.high,
            "from_file": json_number(getattr(JointLimits.of(robot.joint[joint]), key)),
            "description": number.description,
        }
    return found


def values(
    robot: Robot, limits: Limits, names: Iterable[str] | None = None
) -> dict[str, float | None]:
    """Return the values by name; None: all. Raises RpcError for an unknown name."""
    known = _known(robot)
    found = {}
    for name in known if names is None else names:
        joint, key = _place(name, known)
        found[name] = json_number(getattr(limits[joint], key))
    return found


def changed(
    robot: Robot,
    limits: Limits,
    wanted: Mapping[str, Any],
    setpoints_rad_s: Sequence[float],
    *,
    force: bool = False,
) -> dict[str, JointLimits]:
    """Return the changed limits by joint, checked for joints that move at these set-points.
    `force`: also beyond what the robot file allows. Raises RpcError if any value is refused."""
    known = _known(robot)
    changes: dict[str, dict[str, float]] = defaultdict(dict)
    for name, value in wanted.items():
        joint, key = _place(name, known)
        number, asked = _number(robot, joint, key), math.inf if value is None else value
        if not number.takes(asked):
            raise RpcError(f"{name}: {asked} is out of range ({number.span})", INVALID_PARAMS)
        changes[joint][key] = float(asked)
        if len(limit_keys(robot, joint)) < len(NUMBERS) and key == "acceleration_max_rad_s2":
            changes[joint]["deceleration_max_rad_s2"] = float(asked)
    made = {joint: dataclasses.replace(limits[joint], **new) for joint, new in changes.items()}
    for joint, velocity_rad_s in zip(robot.joint, setpoints_rad_s, strict=True):
        if joint in made:
            refuse_wrong(joint_stops(joint, made[joint], velocity_rad_s))
    if not force:
        file = {joint: JointLimits.of(robot.joint[joint]) for joint in made}
        ask_for_force(
            reason
            for joint, new in made.items()
            for reason in joint_beyond_file(joint, new, limits[joint], file[joint])
        )
    return made


def _number(robot: Robot, joint: str, key: str) -> Number:
    number = NUMBERS[key]
    if key != "velocity_max_rad_s":
        return number
    return dataclasses.replace(number, high=robot.joint[joint].velocity_max_rad_s)


def _known(robot: Robot) -> dict[str, tuple[str, str]]:
    """Return joint and key by parameter name."""
    return {
        f"joint.{joint}.{key}": (joint, key)
        for joint in robot.joint
        for key in limit_keys(robot, joint)
    }


def _place(name: str, known: Mapping[str, tuple[str, str]]) -> tuple[str, str]:
    if name not in known:
        near = nearest(name, list(known))
        hint = f"did you mean {near}?" if near else "params.list names them all"
        raise RpcError(f"no parameter {name!r}: {hint}", INVALID_PARAMS)
    return known[name]
