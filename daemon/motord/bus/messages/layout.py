# SPDX-License-Identifier: Apache-2.0
"""Computes where the values of a described message lie in CDR: constants are laid out beforehand,
and values without a fixed length are kept apart."""

from __future__ import annotations

import ast
import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from motord.bus.messages import sources
from motord.bus.messages.cdr import CODES
from motord.bus.messages.description import Description, Row
from motord.bus.messages.sources import Body
from motord.bus.messages.table import TYPES, Field

TIME = "builtin_interfaces/msg/Time"
EXPRESSIONS = MappingProxyType({**vars(sources), "__builtins__": __builtins__})
"""The names that an expression may use beside those of its message."""
_PER_JOINT = re.compile(r"\bjoint\b")
_CONSTANT_NAMES = ("body", "names", "nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant:
    """A value that follows from the robot file alone."""

    code: str
    """Format code of `struct`, for one value."""
    value: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Fixed:
    """A value of a known size."""

    code: str
    """Format code of `struct`; for several values with their number before it."""
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Open:
    """A text, or any number of values."""

    field: Field
    source: str


Item = Constant | Fixed | Open


def per_joint(source: str) -> bool:
    """Return whether an expression has one value for each joint."""
    return _PER_JOINT.search(source) is not None


def zero(field: Field) -> Any:
    """Return the value of a primitive field that a description does not name."""
    one = "" if field.kind == "string" else 0.0 if field.kind.startswith("float") else 0
    one = False if field.kind == "bool" else one
    if field.count is None:
        return one
    return () if field.sequence else (one,) * field.count


def items(described: Description, body: Body, names: Sequence[str]) -> list[Item]:
    """Return the message's values in their order, for joints of those names."""
    rows = {row.path: row for row in described.rows}
    known = {"body": body, "names": names}
    found: list[Item] = []
    for field, source in _leaves(described.type_name, "", rows):
        found += _values(field, source, known)
    return found


def _leaves(type_name: str, prefix: str, rows: Mapping[str, Row]) -> Iterator[tuple[Field, str]]:
    """Yield the fields without parts, and their expressions; a stamp's parts are `sec` and
    `nanosec`."""
    for field in TYPES[type_name]:
        path = prefix + field.name
        source = rows[path].source if path in rows else ""
        if source and field.kind == TIME:
            yield from zip(TYPES[TIME], ("sec", "nanosec"), strict=True)
        elif source or field.primitive:
            yield field, source or repr(zero(field))
        elif field.count is None:
            yield from _leaves(field.kind, f"{path}.", rows)
        elif f"{path}[0]" in {row.split(".")[0] for row in rows}:
            yield Field(name=field.name, kind="uint32"), "1"
            yield from _leaves(field.kind, f"{path}[0].", rows)
        else:
            yield Field(name=field.name, kind="uint32"), "0"


def _constant(expression: ast.expr) -> bool:
    names = {node.id for node in ast.walk(expression) if isinstance(node, ast.Name)}
    return all(name in _CONSTANT_NAMES or name.isupper() for name in names)


def _values(field: Field, source: str, known: Mapping[str, Any]) -> Iterator[Item]:
    expression = ast.parse(source, mode="eval").body
    code = CODES.get(field.kind, "")
    if field.count is None and _constant(expression):
        yield from _constants(field, [_settled(source, known)])
    elif field.count is None:
        yield Fixed(code=code, source=source) if code else Open(field=field, source=source)
    elif isinstance(expression, ast.List):
        for element in expression.elts:
            yield from _values(_one(field), ast.unparse(element), known)
    elif code and per_joint(source):
        count = len(known["names"])
        yield Constant(code="I", value=count)
        for place in range(count):
            yield Fixed(code=code, source=_PER_JOINT.sub(f"joint_{place}", source))
    elif _constant(expression):
        values = _settled(source, known)
        if field.sequence:
            yield Constant(code="I", value=len(values))
        yield from _constants(field, values)
    elif field.sequence:
        yield Open(field=field, source=source)
    else:
        yield Fixed(code=f"{field.count}{code}", source=f"*({source})")


def _one(field: Field) -> Field:
    return Field(name=field.name, kind=field.kind)


def _settled(source: str, known: Mapping[str, Any]) -> Any:
    return eval(source, dict(EXPRESSIONS), dict(known))


def _constants(field: Field, values: Iterable[Any]) -> Iterator[Constant]:
    for value in values:
        if field.kind == "string":
            raw = value.encode() + b"\0"
            yield Constant(code="I", value=len(raw))
            yield from (Constant(code="B", value=byte) for byte in raw)
        else:
            yield Constant(code=CODES[field.kind], value=value)


class Block:
    """Consecutive values of known sizes."""

    def __init__(self, values: Iterable[Constant | Fixed], at: int, before: bytes = b"") -> None:
        """`at`: offset of the block from the end of the header. `before`: bytes to put before the
        block."""
        self.end = at
        self.constants: list[bytes] = []
        self.arguments: list[str] = []
        """Expressions that are passed to `pack`; `constants[0]` is named CONSTANT_0."""
        self._format, self._pending = ["<"], before
        for value in values:
            size = struct.calcsize(f"<{value.code[-1]}")
            self._add(bytes(-self.end % size))
            if isinstance(value, Constant):
                self._add(struct.pack(f"<{value.code}", value.value))
            else:
                self._flush()
                self._format.append(value.code)
                self.arguments.append(value.source)
                self.end += struct.calcsize(f"<{value.code}")

    def _add(self, raw: bytes) -> None:
        self._pending += raw
        self.end += len(raw)

    def _flush(self) -> None:
        raw, self._pending = self._pending, b""
        if raw.count(0) == len(raw):
            self._format.append(f"{len(raw)}x" if raw else "")
        else:
            self.arguments.append(f"CONSTANT_{len(self.constants)}")
            self.constants.append(raw)
            self._format.append(f"{len(raw)}s")

    def struct(self, *, last: bool) -> struct.Struct:
        """Return the struct of all values; `last`: pad it to a multiple of 4, because the message
        ends with it."""
        if last:
            self._add(bytes(-self.end % 4))
        self._flush()
        return struct.Struct("".join(self._format))
