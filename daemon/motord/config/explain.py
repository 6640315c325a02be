# SPDX-License-Identifier: Apache-2.0
"""Pydantic's findings in the terms of the robot file; and a mended copy of the file, so that the
checks which need a whole robot can find the other mistakes in the same run."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydantic_core import ErrorDetails

from motord.config.drives.parts import CHANNEL, PART_NAME
from motord.config.problems import candidates
from motord.config.schema import Node, allowed, choices, describe
from motord.config.sections.bus import HOST, ROUTER
from motord.config.sections.quantities import conversion
from motord.config.toml_lines import Path
from motord_hal.base.nearest import nearest

_NOT_A = {
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "a string",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}
_OUT_OF_RANGE = ("greater_than_equal", "less_than_equal", "finite_number")
_BAD_NAME = "a name is letters, digits, _ and -, begins with a letter, at most 32 long"
_BAD_TEXT = {
    HOST: "is neither the name of a machine nor an address",
    ROUTER: "is neither tcp/HOST:PORT nor tls/HOST:PORT",
    PART_NAME: "must be lower-case letters, digits and _, and begin with a letter",
    CHANNEL: "is not a channel: channels are numbered 1 to 8",
}
"""Texts by pattern; all other patterns are those of names."""
_NOTHING = object()


@dataclass(frozen=True, slots=True)
class Complaint:
    """A problem at a path. In the mended copy `stand_in` replaces the value (`_NOTHING`: the key is
    removed), or `rename` replaces the key, and `factor` times the value replaces the value."""

    path: Path
    text: str
    stand_in: Any = _NOTHING
    rename: str | None = None
    factor: float = 1.0
    decides: bool = False
    """Whether the key decides which other keys its table has."""


def explain(schema: Node, errors: Sequence[ErrorDetails]) -> list[Complaint]:
    """Return one complaint for each mistake in a file of this schema; one that only follows from
    another is left out."""
    found = [
        _complaint(schema, error)
        for error in errors
        if error["type"] != "default_factory_not_called"
    ]
    meant = {(*hit.path[:-1], hit.rename) for hit in found if hit.rename}
    refused = {hit.path[:-1] for hit in found if hit.decides}
    return [
        hit
        for hit in found
        if hit.path not in meant and (hit.decides or hit.path[:-1] not in refused)
    ]


def mended(data: dict[str, Any], complaints: Sequence[Complaint]) -> dict[str, Any]:
    """Return a copy in which stand-ins replace everything that has a complaint."""
    data = copy.deepcopy(data)
    for hit in complaints:
        around: Any = data
        # for a wrong element the whole list is removed
        *parents, key = hit.path[:-1] if isinstance(hit.path[-1], int) else hit.path
        for part in parents:
            inside = isinstance(around, dict | list) and (part in around or isinstance(part, int))
            around = around[part] if inside else None
        if not isinstance(around, dict):
            continue
        value = around.pop(key, None)
        if hit.rename is not None:
            scales = hit.factor != 1.0 and isinstance(value, int | float)
            around.setdefault(hit.rename, value * hit.factor if scales else value)
        elif hit.stand_in is not _NOTHING:
            around[key] = hit.stand_in
    return data


def touched(complaints: Sequence[Complaint]) -> set[Path]:
    """Return the paths that were mended: problems that follow from them are not reported. A table
    without one of its entries counts as mended, too."""
    renamed = {(*hit.path[:-1], hit.rename) for hit in complaints if hit.rename}
    lacking = {hit.path[:-1] for hit in complaints if hit.stand_in is _NOTHING}
    return {hit.path for hit in complaints} | renamed | lacking


def _complaint(schema: Node, error: ErrorDetails) -> Complaint:
    path, node, around = describe(schema, error["loc"])
    kind, value = error["type"], error["input"]
    if kind == "extra_forbidden":
        return _unknown_key(path, around, value)
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _no_kind(path, node, error)
    stand_in = _NOTHING if isinstance(path[-1], int) else _stand_in(node, value)
    if kind == "missing":
        return Complaint(path, f"is missing{_description(node)}{_hint(allowed(node))}", stand_in)
    if kind == "literal_error":
        return Complaint(path, _no_choice(node, value), stand_in)
    if kind in _OUT_OF_RANGE:
        text = f"{_shown(value)} is out of range{_hint(allowed(node))}"
        return Complaint(path, text, stand_in)
    if kind in _NOT_A:
        text = f"{_shown(value)} is not {_NOT_A[kind]}{_quotes(kind, value)}{_hint(allowed(node))}"
        return Complaint(path, text, stand_in)
    if kind == "string_pattern_mismatch":
        bad = _BAD_TEXT.get(error.get("ctx", {}).get("pattern", ""))
        text = f"{_shown(value)} {bad}" if bad else f"{_shown(value)}: {_BAD_NAME}"
        return Complaint(path, text, stand_in)
    if kind == "string_too_short":
        return Complaint(path, "is empty", stand_in)
    return Complaint(path, f"{_shown(value)}: {error['msg']}", stand_in)


def _no_kind(path: Path, node: Node, error: ErrorDetails) -> Complaint:
    """Return the complaint about the key that decides which other keys its table has."""
    key, value = error["ctx"]["discriminator"].strip("'"), error["input"]
    value = value.get(key, _NOTHING) if isinstance(value, dict) else value
    stand_in = _stand_in(node, value)
    if value is _NOTHING:
        text = f"is missing{_description(node)}{_hint(allowed(node))}"
    else:
        text = _no_choice(node, value)
    return Complaint((*path, key), text, stand_in, decides=True)


def _quotes(kind: str, value: Any) -> str:
    """Return how to write the same value in the type that it must have."""
    if kind == "string_type" and isinstance(value, int | float):
        return f": write {_shown(str(value))}"
    if kind in ("float_type", "int_type") and isinstance(value, str):
        number = value.strip().replace(",", ".")
        if re.fullmatch(r"[+-]?\d+(\.\d+)?", number):
            return f": write {number}, without quotes"
    return ""


def _unknown_key(path: Path, around: Node, value: Any) -> Complaint:
    key = str(path[-1])
    known = list(around.get("properties", ()))
    if meant := conversion(key, known):
        text = f"unknown key (motord takes {meant.key}: {meant.how}"
        if isinstance(value, int | float) and not isinstance(value, bool):
            text += f", {meant.key} = {value * meant.factor:.4g}"
        return Complaint(path, f"{text})", rename=meant.key, factor=meant.factor)
    near = nearest(key, known)
    if near is None:
        return Complaint(path, f"unknown key{_hint('known: ' + ', '.join(known))}")
    unit = around["properties"][near].get("unit", "1")
    last = near.rpartition("_")[2]
    in_unit = "" if unit == "1" or last == near or key.endswith(last) else f", in {unit}"
    return Complaint(path, f"unknown key (did you mean {near}{in_unit}?)", rename=near)


def _no_choice(node: Node, value: Any) -> str:
    near = candidates(value, map(str, choices(node))) if isinstance(value, str) else []
    meant = f"; did you mean {' or '.join(map(_shown, near))}?" if near else ""
    return f"{_shown(value)} is unknown{_hint(allowed(node) + meant)}"


def _stand_in(node: Node, value: Any) -> Any:
    """Return a value that may stand here, as near to the given one as possible."""
    if words := choices(node):
        return (nearest(value, map(str, words)) if isinstance(value, str) else None) or words[0]
    if "default" in node:
        return _NOTHING
    simple = {"integer": node.get("minimum"), "number": node.get("minimum"), "string": "x"}
    return simple.get(node.get("type", ""), _NOTHING)


def _description(node: Node) -> str:
    description = " ".join(node.get("description", "").split())
    return f": {description.rstrip('.')}" if description else ""


def _hint(text: str) -> str:
    return f" ({text})" if text else ""


def _shown(value: Any) -> str:
    """Return a value as TOML writes it, cut if it is long."""
    if isinstance(value, dict | list | tuple):
        return "a table" if isinstance(value, dict) else "a list"
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
