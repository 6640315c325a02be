# SPDX-License-Identifier: Apache-2.0
"""Encodes and decodes plain CDR, little-endian, in which every ROS 2 message is sent (DDS-XTypes
1.3, 7.4.1: encoding version 1, final types). Values are aligned to their size, counted from the end
of the header."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cache, lru_cache, partial
from itertools import groupby
from operator import attrgetter
from types import SimpleNamespace
from typing import Any

from motord.bus.messages.table import TYPES, Field

HEADER = b"\x00\x01\x00\x00"
"""CDR_LE, no options: RTPS 2.5, 10.2.1.2."""
CODES = {
    "int8": "b",
    "uint8": "B",
    "char": "B",
    "byte": "B",
    "bool": "?",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_UINT32 = struct.Struct("<I")
_PADS = (b"", bytes(3), bytes(2), bytes(1))
"""Padding to the next multiple of 4, by the number of bytes after the last multiple."""
_WORD_CHARS = 64
Write = Callable[[bytearray, Any], None]


@cache
def _struct(codes: str, phase: int) -> struct.Struct:
    """Return the struct of consecutive values, each aligned, when the first byte lies at offset
    `phase` modulo 8."""
    parts, at = ["<"], phase
    for code in codes:
        size = struct.calcsize(code)
        pad = -at % size
        parts.append("x" * pad + code)
        at += pad + size
    return struct.Struct("".join(parts))


def encode(name: str, message: Any) -> bytearray:
    """Encode a message, an object whose attributes are the type's fields, with its header and
    padded to a multiple of 4. Bytes are taken for a message that is encoded already. Raises
    ValueError for a value that does not fit its field."""
    if isinstance(message, bytes):
        return bytearray(message)
    out = bytearray(HEADER)
    try:
        for write in _writers(name):
            write(out, message)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{name}: {error}") from error
    out.extend(bytes(-len(out) % 4))
    return out


@cache
def _writers(name: str) -> tuple[Write, ...]:
    """Return the functions that write a type. Consecutive fields of fixed size, also those of
    nested types, are written together, and so are strings; the others one by one."""
    writers: list[Write] = []
    for kind, run in groupby(_flat(name), lambda found: _kind(found[1])):
        paths, fields = zip(*run, strict=True)
        if kind == "fixed":
            writers.append(_fixed(paths, "".join(CODES[field.kind] for field in fields)))
        elif kind == "string":
            writers.append(_strings(paths))
        else:
            writers += map(_variable, paths, fields)
    return tuple(writers)


def _kind(field: Field) -> str:
    if field.count is not None:
        return "variable"
    return "string" if field.kind == "string" else "fixed"


def _flat(name: str, prefix: str = "") -> Iterator[tuple[str, Field]]:
    for field in TYPES[name]:
        if field.primitive or field.count is not None:
            yield prefix + field.name, field
        else:
            yield from _flat(field.kind, f"{prefix}{field.name}.")


def _fixed(paths: Sequence[str], codes: str) -> Write:
    get = attrgetter(*paths)
    packs = [_struct(codes, phase).pack for phase in range(8)]
    if len(paths) == 1:
        return lambda out, message: out.extend(packs[(len(out) - 4) & 7](get(message)))
    return lambda out, message: out.extend(packs[(len(out) - 4) & 7](*get(message)))


def _strings(paths: Sequence[str]) -> Write:
    get: Callable[[Any], Any] = attrgetter(*paths)
    if len(paths) == 1:
        return lambda out, message: write_strings(out, (get(message),))
    return lambda out, message: write_strings(out, get(message))


def _variable(path: str, field: Field) -> Write:
    """Return the function that writes a field with several values."""
    get, write = attrgetter(path), values_writer(field)
    return lambda out, message: write(out, get(message))


def values_writer(field: Field) -> Write:
    """Return the function that appends the values of a field that has several."""
    write_items = _items(field)
    if not field.sequence:
        return write_items

    def write(out: bytearray, items: Any) -> None:
        out.extend(bytes(-len(out) % 4))
        out.extend(_UINT32.pack(len(items)))
        if items:
            write_items(out, items)

    return write


def _items(field: Field) -> Write:
    if field.kind == "string":
        return write_strings
    if field.primitive:
        code = CODES[field.kind]
        return lambda out, items: out.extend(
            _struct(
                code * (field.count if field.count and not field.bounded else len(items)),
                (len(out) - 4) & 7,
            ).pack(*items)
        )

    writers = _writers(field.kind)

    def write_nested(out: bytearray, items: Sequence[Any]) -> None:
        for item in items:
            for write in writers:
                write(out, item)

    return write_nested


def write_strings(out: bytearray, texts: Sequence[str]) -> None:
    """Append texts, each with its length before it."""
    for text in texts:
        out += _PADS[len(out) & 3]
        out += _word(text) if len(text) < _WORD_CHARS else _string(text)


def _string(text: str) -> bytes:
    raw = text.encode()
    return _UINT32.pack(len(raw) + 1) + raw + b"\0"


_word = lru_cache(1024)(_string)
"""`_string` with a cache: the same names and states are written again and again."""


def decode(name: str, raw: bytes) -> SimpleNamespace:
    """Decode a message. Raises ValueError for bytes that are not of that type; bytes after the
    message are ignored."""
    if raw[:2] != HEADER[:2]:
        raise ValueError(f"{name}: not in plain little-endian CDR (it begins {raw[:4].hex()})")
    try:
        return _Reader(raw).message(name)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise ValueError(f"{name}: {error}") from error


Step = str | Field
"""The codes of consecutive fixed fields, or one field of any length."""


@cache
def _steps(name: str) -> tuple[Step, ...]:
    """Return the steps in which a type is read."""
    steps: list[Step] = []
    for _, field in _flat(name):
        if field.count is not None or field.kind == "string":
            steps.append(field)
        elif steps and isinstance(steps[-1], str):
            steps[-1] += CODES[field.kind]
        else:
            steps.append(CODES[field.kind])
    return tuple(steps)


@cache
def _shape(name: str) -> Callable[[Iterator[Any]], SimpleNamespace]:
    """Return the function from values that were read to a message with its nested messages."""
    parts = [
        (field.name, None if field.primitive or field.count is not None else _shape(field.kind))
        for field in TYPES[name]
    ]

    def made(values: Iterator[Any]) -> SimpleNamespace:
        found = {key: shape(values) if shape else next(values) for key, shape in parts}
        return SimpleNamespace(**found)

    return made


class _Reader:
    def __init__(self, raw: bytes) -> None:
        self._raw = raw
        self._at = len(HEADER)

    def message(self, name: str) -> SimpleNamespace:
        values: list[Any] = []
        for step in _steps(name):
            if isinstance(step, str):
                layout = _struct(step, (self._at - len(HEADER)) & 7)
                values += layout.unpack_from(self._raw, self._at)
                self._at += layout.size
            else:
                values.append(self._field(step))
        return _shape(name)(iter(values))

    def _field(self, field: Field) -> Any:
        """Read a string, or several values."""
        if field.count is None:
            return self._string()
        count = self._values("I", 1)[0] if field.sequence else field.count
        if field.primitive and field.kind != "string":
            return self._values(CODES[field.kind], count)
        if count > len(self._raw) - self._at:  # each takes a byte at least
            raise IndexError("longer than its bytes")
        read = self._string if field.kind == "string" else partial(self.message, field.kind)
        return tuple(read() for _ in range(count))

    def _values(self, code: str, count: int) -> tuple[Any, ...]:
        size = struct.calcsize(f"<{code}")
        if count == 0:
            return ()
        start = self._at + (len(HEADER) - self._at) % size
        self._at = start + count * size
        if self._at > len(self._raw):
            raise IndexError("longer than its bytes")
        return struct.unpack_from(f"<{count}{code}", self._raw, start)

    def _string(self) -> str:
        length = self._values("I", 1)[0]
        start, self._at = self._at, self._at + length
        if self._at > len(self._raw):
            raise IndexError("longer than its bytes")
        return self._raw[start : self._at].removesuffix(b"\0").decode()
