# SPDX-License-Identifier: Apache-2.0
"""Gains of the speed loops by name: `joint.left.speed_loop.gain_s_per_rad` and the like, as in the
robot file. They change while the robot moves, without a step of the output."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from motord.config import Robot
from motord.config.sections.joint.speed_loop import GAIN_NUMBERS, SpeedLoop
from motord.config.sections.joint.wheels import gains_of
from motord.local_socket.server import INVALID_PARAMS, RpcError
from motord_hal.base.nearest import nearest

PREFIX = "joint."
_TABLE = "speed_loop"


def is_gain(name: str) -> bool:
    """Return whether a name has the form of a gain; other parameters of joints are limits."""
    return f".{_TABLE}." in name or name.endswith(f".{_TABLE}")


def listed(robot: Robot, loops: Mapping[str, SpeedLoop]) -> dict[str, dict[str, Any]]:
    """Return value, unit, range and description of every gain."""
    return {
        name: {
            "value": getattr(loops[joint], key),
            "unit": GAIN_NUMBERS[key].unit,
            "minimum": GAIN_NUMBERS[key].low,
            "maximum": GAIN_NUMBERS[key].high,
            "description": GAIN_NUMBERS[key].description,
        }
        for name, (joint, key) in _known(robot, loops).items()
    }


def values(
    robot: Robot, loops: Mapping[str, SpeedLoop], names: Iterable[str] | None = None
) -> dict[str, float]:
    """Return the values by name; None: all. Raises RpcError for an unknown name."""
    known = _known(robot, loops)
    found = {}
    for name in known if names is None else names:
        joint, key = _place(name, known)
        found[name] = getattr(loops[joint], key)
    return found


def changed(
    robot: Robot, loops: Mapping[str, SpeedLoop], wanted: Mapping[str, Any]
) -> dict[str, SpeedLoop]:
    """Return the changed loops by joint. Raises RpcError if any value is refused."""
    known = _known(robot, loops)
    changes: dict[str, dict[str, float]] = defaultdict(dict)
    for name, value in wanted.items():
        joint, key = _place(name, known)
        number = GAIN_NUMBERS[key]
        if not number.takes(value):
            raise RpcError(f"{name}: {value} is out of range ({number.span})", INVALID_PARAMS)
        changes[joint][key] = float(value)
    return {joint: SpeedLoop(**(vars(loops[joint]) | new)) for joint, new in changes.items()}


def _known(robot: Robot, loops: Mapping[str, SpeedLoop]) -> dict[str, tuple[str, str]]:
    """Return joint and key by parameter name."""
    return {f"{PREFIX}{joint}.{_TABLE}.{key}": (joint, key) for joint, key in _keys(robot, loops)}


def _keys(robot: Robot, loops: Mapping[str, SpeedLoop]) -> Iterator[tuple[str, str]]:
    profiles = robot.profiles
    for name in loops:
        joint = robot.joint[name]
        yield from ((name, key) for key in gains_of(joint, profiles[joint.drive]))


def _place(name: str, known: Mapping[str, tuple[str, str]]) -> tuple[str, str]:
    if name not in known:
        near = nearest(name, list(known))
        hint = f"did you mean {near}?" if near else "params.list names them all"
        if not known:
            hint = "the drives of this robot hold the speed of their wheels by themselves"
        raise RpcError(f"no parameter {name!r}: {hint}", INVALID_PARAMS)
    return known[name]
