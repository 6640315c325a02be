# SPDX-License-Identifier: Apache-2.0
"""Types of `table.TYPES` as the Cyclone DDS binding expects them, created at first use. The binding
needs them to announce a topic; `cdr` encodes the messages themselves."""

from __future__ import annotations

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types

from motord.bus.messages.table import TYPES, Field
from motord.bus.ros2.names import dds_type

idl: Any = types
"""The module `types` as Any: a type checker does not accept its generic types as classes."""
_PRIMITIVES: dict[str, Any] = {
    "int8": idl.int8,
    "uint8": idl.uint8,
    "char": idl.uint8,
    "byte": idl.byte,
    "int16": idl.int16,
    "uint16": idl.uint16,
    "int32": idl.int32,
    "uint32": idl.uint32,
    "int64": idl.int64,
    "uint64": idl.uint64,
    "float32": idl.float32,
    "float64": idl.float64,
    "bool": bool,
    "string": str,
}


@cache
def cyclone_type(name: str, *, service: bool = False) -> type[IdlStruct]:
    """Return the class for a type of `table.TYPES`. A request or reply of a service begins with the
    client and the number of the request (rmw_cyclonedds)."""
    header = {"guid": idl.uint64, "seq": idl.int64} if service else {}
    fields = header | {field.name: _annotation(field) for field in TYPES[name]}
    return make_idl_struct(name.replace("/", "_"), dds_type(name), fields)


def _annotation(field: Field) -> Any:
    single = _PRIMITIVES[field.kind] if field.primitive else cyclone_type(field.kind)
    if field.chars_max:
        single = idl.bounded_str[field.chars_max]
    if field.count is None:
        return single
    if field.bounded:
        return idl.sequence[single, field.count]
    return idl.array[single, field.count] if field.count else idl.sequence[single]
