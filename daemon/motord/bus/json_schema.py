# SPDX-License-Identifier: Apache-2.0
"""The JSON Schema of a message type, from its dataclass: for recordings and for Foxglove."""

from __future__ import annotations

import dataclasses
import enum
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

_PLAIN: dict[type, dict[str, Any]] = {
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": ["number", "null"]},  # NaN and infinity are null
    str: {"type": "string"},
}


@cache
def schema_of(kind: type) -> dict[str, Any]:
    """Of a dataclass of `message_types`, nested ones written out. Raises TypeError for what none of
    them is made of."""
    if kind in _PLAIN:
        return _PLAIN[kind]
    if isinstance(kind, type) and issubclass(kind, enum.IntEnum):
        return _PLAIN[int]
    if get_origin(kind) is tuple:
        return {"type": "array", "items": schema_of(get_args(kind)[0])}
    if not dataclasses.is_dataclass(kind):
        raise TypeError(f"{kind} is not what messages are made of")
    hints = get_type_hints(kind)
    fields = [field.name for field in dataclasses.fields(kind)]
    return {
        "title": kind.__name__,
        "type": "object",
        "properties": {name: schema_of(hints[name]) for name in fields},
        "required": fields,
    }
