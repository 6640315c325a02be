# SPDX-License-Identifier: Apache-2.0
"""Parameters of the running robot by name: `limits.linear_m_s` and its like, as in the robot file.

JSON has no infinity: null stands for "no limit" where the robot file says inf.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import ValidationError

from motord.assembly import base_limits
from motord.config import Limits
from motord.config.model import REST_MAX_S
from motord.config.problems import nearest
from motord.rpc import INVALID_PARAMS, RpcError, json_number
from motord.rt import limits_problem

_PREFIX = "limits."


def listed(limits: Limits) -> dict[str, dict[str, Any]]:
    """Every parameter: value, unit, range and what it is."""
    properties = Limits.model_json_schema()["properties"]
    return {
        _PREFIX + key: {
            "value": json_number(getattr(limits, key)),
            "unit": schema["unit"],
            "minimum": schema["minimum"],
            "maximum": schema.get("maximum"),
            "description": schema["description"],
        }
        for key, schema in properties.items()
    }


def values(limits: Limits, names: Iterable[str] = ()) -> dict[str, float | None]:
    """By name; no name: all. Raises RpcError for an unknown one."""
    keys = [_key(name) for name in names] or list(Limits.model_fields)
    return {_PREFIX + key: json_number(getattr(limits, key)) for key in keys}


def changed(
    limits: Limits, wanted: Mapping[str, Any], linear_m_s: float = 0.0, angular_rad_s: float = 0.0
) -> Limits:
    """All of them as one group, whether they were set before or not, for a robot that moves so.
    Raises RpcError: then none."""
    asked = {_key(name): math.inf if value is None else value for name, value in wanted.items()}
    try:
        made = Limits.model_validate({**limits.model_dump(), **asked})
    except ValidationError as error:
        raise RpcError(_out_of_range(error), INVALID_PARAMS) from error
    if (problem := limits_problem(base_limits(made))) is not None:
        raise RpcError(f"the core refuses {problem}: out of range", INVALID_PARAMS)
    if (rest_s := made.rest_s(linear_m_s, angular_rad_s)) > REST_MAX_S:
        raise RpcError(
            f"it would take {rest_s:.0f} s to rest (at most {REST_MAX_S:g} s): more deceleration "
            "and jerk, or less speed",
            INVALID_PARAMS,
        )
    return made


def _out_of_range(error: ValidationError) -> str:
    """In the words of `params list`: which value, and the range with its unit."""
    first = error.errors()[0]
    key = str(first["loc"][0])
    schema = Limits.model_json_schema()["properties"][key]
    low, high, unit = schema["minimum"], schema.get("maximum"), schema["unit"]
    span = f"at least {low:g}" if high is None else f"{low:g} to {high:g}"
    return f"{_PREFIX}{key}: {first['input']} is out of range ({span} {unit})"


def _key(name: str) -> str:
    key = name.removeprefix(_PREFIX)
    if not name.startswith(_PREFIX) or key not in Limits.model_fields:
        near = nearest(name, [_PREFIX + known for known in Limits.model_fields])
        hint = f"did you mean {near}?" if near else "params.list names them all"
        raise RpcError(f"no parameter {name!r}: {hint}", INVALID_PARAMS)
    return key
