# SPDX-License-Identifier: Apache-2.0
"""The JSON Schemas of the robot file and of drive profiles, for editors (`motord schema`) and for
the texts of errors."""

from __future__ import annotations

import ast
import functools
import inspect
import itertools
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from motord.config.drives.tables import DriveFile
from motord.config.sections.model import Robot
from motord.config.sections.section import Section
from motord.config.toml_lines import Path

Node = Mapping[str, Any]


def robot_schema() -> dict[str, Any]:
    """Return the schema of the robot file, draft 2020-12; each number's SI unit stands beside it as
    `unit`."""
    return _schema(Robot, "urn:motord:robot-file:1", "motord robot file")


def drive_schema() -> dict[str, Any]:
    """Return the schema of a drive profile; a number in the drive's own unit has `unit` "1"."""
    return _schema(DriveFile, "urn:motord:drive-profile:1", "motord drive profile")


def _schema(root: type[Section], identifier: str, title: str) -> dict[str, Any]:
    """Return the schema of a file. `identifier` does not change with the place of the schema's
    file."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": identifier,
        **root.model_json_schema(),
        "title": title,
    }
    _drop_infinities(schema)
    for model in _sections(Section):
        table = schema if model is root else schema["$defs"].get(model.__name__)
        for name, text in _texts_of(model).items() if table else ():
            if field := model.model_fields.get(name):
                table["properties"][field.alias or name].setdefault("description", text)
    return schema


def _sections(model: type[Section]) -> Iterator[type[Section]]:
    for kind in model.__subclasses__():
        yield kind
        yield from _sections(kind)


def _texts_of(model: type[Section]) -> dict[str, str]:
    """Return the string below each field, by the field's name. Pydantic could read these strings
    itself, but it would do so at every start of a program, for 0.1 s."""
    found: dict[str, str] = {}
    for kind in reversed(model.__mro__):
        if issubclass(kind, Section):
            found |= _texts_in(kind.__module__)[kind.__name__]
    return found


@functools.cache
def _texts_in(module: str) -> dict[str, dict[str, str]]:
    """Return the strings below the fields of each class of a module."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {node.name: dict(_texts(node)) for node in tree.body if isinstance(node, ast.ClassDef)}


def _texts(body: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for field, text in itertools.pairwise(body.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            yield ast.unparse(field.target), inspect.cleandoc(ast.literal_eval(text.value))


def _drop_infinities(node: Any) -> None:
    """Remove infinite defaults: JSON has no infinity, and the description names them."""
    if isinstance(node, dict):
        default = node.get("default")
        if isinstance(default, float) and math.isinf(default):
            del node["default"]
        node = list(node.values())
    if isinstance(node, list):
        for child in node:
            _drop_infinities(child)


def describe(schema: Node, place: Iterable[str | int]) -> tuple[Path, Node, Node]:
    """Follow pydantic's place of an error, which also holds the kinds of tables, into the schema.

    Returns the path in the TOML file, the schema of what is there (empty: nothing is known there)
    and that of the table around it.
    """
    path: Path = ()
    node = around = _resolve(schema, schema)
    for part in place:
        kinds = _kinds(node)
        if part in kinds:
            node = _resolve(schema, {"$ref": kinds[str(part)]})
        elif named := _option(node, part):
            node = _resolve(schema, named)
        elif part != "[key]":
            path, around = (*path, part), node
            node = _resolve(schema, _child(node, part))
    return path, node, around


def _kinds(node: Node) -> Mapping[str | int, str]:
    mapping: Mapping[str | int, str] = node.get("discriminator", {}).get("mapping", {})
    return mapping


def _option(node: Node, part: str | int) -> Node | None:
    """Return the option of that name among several tables, or words, that may stand here."""
    for option in node.get("oneOf", ()):
        if option.get("$ref", "#/$defs/word") == f"#/$defs/{part}":
            found: Node = option
            return found
    return None


def _child(node: Node, part: str | int) -> Node:
    if isinstance(part, int):
        items: Node = node.get("items", {})
        return items
    named: Node = node.get("properties", {})
    others = [*node.get("patternProperties", {}).values(), node.get("additionalProperties")]
    found: Node = named.get(part) or next((other for other in others if other), {})
    return found


def _resolve(schema: Node, node: Node) -> Node:
    """Return the node itself, behind a reference or a choice with null."""
    for option in node.get("anyOf", ()):
        if option.get("type") != "null":
            node = {**node, **option}
    if "$ref" in node:
        name = node["$ref"].removeprefix("#/$defs/")
        node = {**schema["$defs"][name], **{key: node[key] for key in node if key != "$ref"}}
    return node


def choices(node: Node) -> list[str | int]:
    """Return the words or numbers that may stand here; empty: any may."""
    if "const" in node:
        return [node["const"]]
    return list(node.get("enum", ())) or [str(kind) for kind in _kinds(node)]


def allowed(node: Node) -> str:
    """Return what is allowed, as text: `0.02 to 20 m`, `"left", "right"`, or nothing."""
    unit = node.get("unit", "1")
    suffix = "" if unit == "1" else f" {unit}"
    low, high = node.get("minimum"), node.get("maximum")
    if low is not None:
        form = "" if node.get("type") == "integer" else "g"
        least = f"{low:{form}}"
        if high is None:
            return f"at least {least}{suffix}"
        return f"{least} to {high:{form}}{suffix}"
    return ", ".join(json.dumps(choice) for choice in choices(node))
