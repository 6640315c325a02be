# SPDX-License-Identifier: Apache-2.0
"""Parameters of the running robot by name: `limits.linear_m_s` and the like, as in the robot file.

JSON has no infinity: null means no limit, as inf does in the robot file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from motord.config import Limits
from motord.config.sections.bases import AnyBase, JointsBase
from motord.config.sections.limits import LATERAL_KEYS, REST_MAX_S
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


def listed(limits: Limits, base: AnyBase) -> dict[str, dict[str, Any]]:
    """Return value, unit, range and description of every parameter."""
    return {
        _PREFIX + key: {
            "value": json_number(getattr(limits, key)),
            "unit": number.unit,
            "minimum": number.low,
            "maximum": number.high,
            "description": number.description,
        }
        for key, number in _numbers(base).items()
    }


def values(limits: Limits, base: AnyBase, names: Iterable[str] = ()) -> dict[str, float | None]:
    """Return the values by name; no name: all. Raises RpcError for an unknown name."""
    keys = [_key(name, base) for name in names] or list(_numbers(base))
    return {_PREFIX + key: json_number(getattr(limits, key)) for key in keys}


def changed(
    limits: Limits,
    base: AnyBase,
    wanted: Mapping[str, Any],
    linear_m_s: float = 0.0,
    angular_rad_s: float = 0.0,
    lateral_m_s: float = 0.0,
) -> Limits:
    """Return the limits with all wanted values, checked as one group for a robot that moves at
    these speeds. A limit that is not wanted keeps its value, also if the robot file does not give
    it. Raises RpcError if any value is refused."""
    keys = {name: _key(name, base) for name in wanted}
    if not keys:
        return limits
    asked = {keys[name]: _in_range(keys[name], value) for name, value in wanted.items()}
    made = Limits(**(vars(limits) | asked))
    if (problem := limits_problem(base_limits(made))) is not None:
        raise RpcError(f"the core refuses {problem}: out of range", INVALID_PARAMS)
    rest_s = made.rest_s(linear_m_s, angular_rad_s, lateral_m_s, strafes=base.strafes)
    if rest_s > REST_MAX_S:
        raise RpcError(
            f"it would take {rest_s:.0f} s to rest (at most {REST_MAX_S:g} s): more deceleration "
            "and jerk, or less speed",
            INVALID_PARAMS,
        )
    return made


def _in_range(key: str, value: Any) -> float:
    """Return the value (None: infinity). Raises RpcError if it is out of range, with the range and
    its unit as in `params list`."""
    number, asked = _NUMBERS[key], math.inf if value is None else value
    if not number.takes(asked):
        raise RpcError(f"{_PREFIX}{key}: {asked} is out of range ({number.span})", INVALID_PARAMS)
    return float(asked)


def _key(name: str, base: AnyBase) -> str:
    key, numbers = name.removeprefix(_PREFIX), _numbers(base)
    if not name.startswith(_PREFIX) or key not in numbers:
        near = nearest(name, [_PREFIX + known for known in numbers])
        hint = f"did you mean {near}?" if near else "params.list names them all"
        if isinstance(base, JointsBase):
            hint = "there is no base: limits are those of each joint, as joint.NAME.KEY"
        raise RpcError(f"no parameter {name!r}: {hint}", INVALID_PARAMS)
    return key
