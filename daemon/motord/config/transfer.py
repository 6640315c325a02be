# SPDX-License-Identifier: Apache-2.0
"""The robot and its drive profiles as JSON, for another process. The reader makes objects of the
classes that it names itself, and runs no code of the text: what comes from a process that was
deceived is wrong data at worst."""

from __future__ import annotations

import enum
import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

_STATE = ("__dict__", "__pydantic_private__", "__pydantic_fields_set__")
"""The parts of a section's state, by the names of pydantic; motord/config/plain.py has them,
too."""
_COLLECTIONS = {"dict": dict, "frozenset": frozenset, "list": list}
_TEXTS: dict[str, tuple[type, Callable[[Any], str], Callable[[str], Any]]] = {
    "Path": (Path, str, Path),
    "bytes": (bytes, bytes.hex, bytes.fromhex),
    "datetime": (datetime, str, datetime.fromisoformat),  # before date, of which it is a kind
    "date": (date, str, date.fromisoformat),
    "time": (time, str, time.fromisoformat),
}
"""Types with a text of their own, what writes it and what reads it."""


def classes_of(*classes: type) -> dict[str, type]:
    """Return these classes and all that are derived from them, by their names in the text."""
    found = {_name(one): one for one in classes}
    for one in classes:
        found |= classes_of(*one.__subclasses__())
    return found


def classes_in(*modules: object) -> dict[str, type]:
    """Return the dataclasses and enumerations of these modules, by their names in the text."""
    found = [one for module in modules for one in vars(module).values() if isinstance(one, type)]
    return {_name(one): one for one in found if is_dataclass(one) or issubclass(one, enum.Enum)}


def dumps(value: Any) -> str:
    """Return a value as text. Raises TypeError for one whose form is not known."""
    return json.dumps(_encoded(value), separators=(",", ":"))


def loads(text: str | bytes, classes: Mapping[str, type]) -> Any:
    """Return the value of a text that may name these classes. Raises ValueError for any other."""
    try:
        return _decoded(json.loads(text), classes)
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"not the form of a robot: {error!r}") from error


def _name(one: type) -> str:
    return f"{one.__module__}.{one.__qualname__}"


def _encoded(value: Any) -> Any:
    """Return the value in the types of JSON: an array is a tuple, an object has one key, which
    names the type."""
    if isinstance(value, enum.Enum):
        return {_name(type(value)): value.value}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, tuple):
        return [_encoded(one) for one in value]
    if isinstance(value, Mapping):
        return {"dict": [[_encoded(key), _encoded(one)] for key, one in value.items()]}
    if isinstance(value, list | set | frozenset):
        name = "list" if isinstance(value, list) else "frozenset"
        return {name: [_encoded(one) for one in value]}
    for name, (kind, written, _) in _TEXTS.items():
        if isinstance(value, kind):
            return {name: written(value)}
    if is_dataclass(value):
        given = {field.name: getattr(value, field.name) for field in fields(value)}
        return {_name(type(value)): {name: _encoded(one) for name, one in given.items()}}
    if hasattr(value, "model_fields_set"):
        state = value.__getstate__()
        return {_name(type(value)): [_encoded(state[part]) for part in _STATE]}
    raise TypeError(f"{type(value).__name__} has no form as text")


def _decoded(found: Any, classes: Mapping[str, type]) -> Any:
    if isinstance(found, list):
        return tuple(_decoded(one, classes) for one in found)
    if not isinstance(found, dict):
        return found
    ((name, raw),) = found.items()
    if name in _COLLECTIONS:
        return _COLLECTIONS[name](_decoded(raw, classes))
    if name in _TEXTS:
        return _TEXTS[name][2](raw)
    kind = classes[name]
    if issubclass(kind, enum.Enum):
        return kind(raw)
    if is_dataclass(kind):
        return kind(**{field: _decoded(one, classes) for field, one in raw.items()})
    section = object.__new__(kind)
    state = (_decoded(part, classes) for part in raw)
    section.__setstate__(dict(zip(_STATE, state, strict=True)))  # type: ignore[attr-defined]
    return section
