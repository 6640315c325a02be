# SPDX-License-Identifier: Apache-2.0
"""Parameters of the running robot by name: `limits.linear_m_s` and the like, as in the robot file.

JSON has no infinity: null means no limit, as inf does in the robot file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from motord.api.local_rpc import NEEDS_FORCE
from motord.config import Limits, Robot
from motord.config.finding import Finding
from motord.config.rules.limits import beyond_file, ceiling, settable_max, stops
from motord.config.sections.bases import AnyBase, JointsBase
from motord.config.sections.limits import LATERAL_KEYS
from motord.config.sections.section import Number, numbers_of
from motord.control.assembly import base_limits
from motord.local_socket.server import INVALID_PARAMS, RpcError, json_number
from motord.realtime.loop import limits_problem
from motord_hal.base.nearest import nearest

_PREFIX = "limits."
_NUMBERS = numbers_of(Limits)


def _numbers(base: AnyBase) -> Mapping[str, Number]:
    """Return the limits that this base has; without a base none, as each joint has its own there
    (`joint_parameters`)."""
    if isinstance(base, JointsBase):
        return {}
    return {key: one for key, one in _NUMBERS.items() if base.strafes or key not in LATERAL_KEYS}


def listed(robot: Robot, limits: Limits) -> dict[str, dict[str, Any]]:
    """Return value, unit, range and description of every parameter. The range ends where the wheels
    do; `from_file` is the robot file's value: more needs `force`."""
    numbers = _settable(robot)
    return {
        _PREFIX + key: {
            "value": json_number(getattr(limits, key)),
            "unit": number.unit,
            "minimum": number.low,
            "maximum": number.high,
            "from_file": json_number(getattr(robot.limits, key)),
            "description": number.description,
        }
        for key, number in numbers.items()
    }


def values(limits: Limits, base: AnyBase, names: Iterable[str] = ()) -> dict[str, float | None]:
    """Return the values by name; no name: all. Raises RpcError for an unknown name."""
    keys = [_key(name, base) for name in names] or list(_numbers(base))
    return {_PREFIX + key: json_number(getattr(limits, key)) for key in keys}


def changed(
    robot: Robot,
    limits: Limits,
    wanted: Mapping[str, Any],
    moving: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    force: bool = False,
) -> Limits:
    """Return the limits with all wanted values, checked as one group for a robot that moves at
    these speeds (m/s, rad/s, m/s to the left). A limit that is not wanted keeps its value, also if
    the robot file does not give it. `force`: also beyond what the robot file allows. Raises
    RpcError if any value is refused."""
    keys = {name: _key(name, robot.base) for name in wanted}
    if not keys:
        return limits
    numbers = _settable(robot)
    asked = {key: _in_range(key, wanted[name], numbers[key]) for name, key in keys.items()}
    made = Limits(**(vars(limits) | asked))
    if (problem := limits_problem(base_limits(made))) is not None:
        raise RpcError(f"the core refuses {problem}: out of range", INVALID_PARAMS)
    strafes = robot.base.strafes
    refuse_wrong(stops(made, strafes=strafes, moving=moving))
    if not force:
        changing = frozenset(asked)
        ask_for_force(beyond_file(made, limits, robot.limits, changing, strafes=strafes))
    return made


def refuse_wrong(found: Iterable[Finding]) -> None:
    """Raise RpcError for the first finding that is an error in a robot file, too."""
    for one in found:
        if not one.warning:
            raise RpcError(f"{'.'.join(map(str, one.paths[0]))}: {one.text}", INVALID_PARAMS)


def ask_for_force(beyond: Iterable[str]) -> None:
    """Raise RpcError, with all reasons, if the limits go beyond the robot file."""
    if reasons := list(beyond):
        raise RpcError(
            f"{'; '.join(reasons)}: is there room for it? motord params set --force sets it all "
            "the same (a page asks), or write it into the robot file and check that",
            NEEDS_FORCE,
        )


def _settable(robot: Robot) -> dict[str, Number]:
    """Return the limits of this base, with ranges that end at what its wheels can do."""
    numbers = _numbers(robot.base)
    if not numbers:
        return {}
    most = ceiling(robot, robot.profiles)
    highs = {key: settable_max(robot.limits, key, most) for key in numbers}
    return {
        key: replace(number, high=highs[key] if math.isfinite(highs[key]) else None)
        for key, number in numbers.items()
    }


def _in_range(key: str, value: Any, number: Number) -> float:
    """Return the value (None: infinity). Raises RpcError if it is out of range, with the range and
    its unit as in `params list`."""
    asked = math.inf if value is None else value
    if number.takes(asked):
        return float(asked)
    text = f"{_PREFIX}{key}: {asked} is out of range ({number.span})"
    if _NUMBERS[key].takes(asked):
        text += ": the wheels can do no more"
    raise RpcError(text, INVALID_PARAMS)


def _key(name: str, base: AnyBase) -> str:
    key, numbers = name.removeprefix(_PREFIX), _numbers(base)
    if not name.startswith(_PREFIX) or key not in numbers:
        near = nearest(name, [_PREFIX + known for known in numbers])
        hint = f"did you mean {near}?" if near else "params.list names them all"
        if isinstance(base, JointsBase):
            hint = "there is no base: limits are those of each joint, as joint.NAME.KEY"
        raise RpcError(f"no parameter {name!r}: {hint}", INVALID_PARAMS)
    return key
