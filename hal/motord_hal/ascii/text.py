# SPDX-License-Identifier: Apache-2.0
"""Templates of lines of text: `{left:.2f},{right:.2f}\\n` writes two numbers and reads them again.

A template that is a JSON object, `{{"T":1,"L":{left:.3f}}}\\n` (its own braces are doubled), is
read by the names of its members, in any order. Other members are skipped.
"""

from __future__ import annotations

import json
import math
import re
import string
from collections.abc import Collection, Mapping

LINE_BYTES_MAX = 256
DEFAULT_FORMAT = ".3f"
_MARK = "\0"
"""Prefix that marks a field in a JSON object. No text contains it."""
_FORMAT = re.compile(r"[+ ]?0?\d{0,2}(\.\d{1,2})?[dfg]?")
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"


class Text:
    """A template whose fields are numbers. Raises ValueError with the reason if it is not valid."""

    def __init__(self, template: str, known: Collection[str]) -> None:
        self.template = template
        self.fields: tuple[str, ...] = ()
        self._parts: list[tuple[str, str | None, str]] = []
        try:
            before = ""
            for literal, name, spec, conversion in string.Formatter().parse(template):
                before += literal
                if name is not None:
                    _check_field(name, spec or "", conversion, known)
                    self._parts.append((before, name, spec or DEFAULT_FORMAT))
                    before = ""
            if before:
                self._parts.append((before, None, DEFAULT_FORMAT))
        except ValueError as error:
            raise ValueError(str(error)) from None
        self.fields = tuple(name for _, name, _ in self._parts if name is not None)
        self._check()
        self._pattern = re.compile(self._regex())
        self.members = self._members() if template.lstrip().startswith("{{") else {}
        """Member name → field or constant; empty: the template is not a JSON object."""

    def _check(self) -> None:
        if not self.fields:
            raise ValueError("there is no {field} in it")
        if len(set(self.fields)) != len(self.fields):
            raise ValueError("a field is in it twice")
        if any(not literal for literal, name, _ in self._parts[1:] if name is not None):
            raise ValueError("two fields need a separator between them")
        if not self.template.isascii():
            raise ValueError("it must be ASCII")
        if len(self.say(dict.fromkeys(self.fields, -1e9))) > LINE_BYTES_MAX:
            raise ValueError(f"it makes lines of more than {LINE_BYTES_MAX} bytes")

    def _members(self) -> dict[str, str | float]:
        """Return the members of a JSON template. Raises ValueError if it is not valid."""
        marked = "".join(
            literal + ("" if name is None else json.dumps(_MARK + name))
            for literal, name, _ in self._parts
        )
        try:
            found = json.loads(marked)
        except ValueError as error:
            raise ValueError(f"it begins like a JSON object but is not one: {error}") from None
        members: dict[str, str | float] = {}
        for name, value in found.items():
            is_field = isinstance(value, str) and value.startswith(_MARK)
            if not is_field and (isinstance(value, bool) or not isinstance(value, int | float)):
                raise ValueError(f'member "{name}" must be a number or a {{field}}')
            if not name or set(name) & set('"\\'):
                raise ValueError(f'member "{name}": a name has 1 character or more, and no escape')
            members[name] = value.removeprefix(_MARK) if isinstance(value, str) else float(value)
        return members

    def _regex(self) -> str:
        """Return the pattern of a line. Any white space matches any other; at the ends none is
        needed."""
        parts = []
        for literal, name, _ in self._parts:
            words = re.split(r"\s+", literal)
            parts.append(r"\s+".join(re.escape(word) for word in words))
            if name is not None:
                parts.append(_NUMBER)
        return "".join(parts).removeprefix(r"\s+").removesuffix(r"\s+")

    def say(self, values: Mapping[str, float]) -> bytes:
        """Return the text with these numbers. NaN and infinity become 0."""
        out = []
        for literal, name, spec in self._parts:
            out.append(literal)
            if name is not None:
                value = values[name] if math.isfinite(values[name]) else 0.0
                out.append(format(round(value) if spec.endswith("d") else value, spec))
        return "".join(out).encode("ascii")

    @property
    def parts(self) -> tuple[tuple[str, str | None, str], ...]:
        """Parts of the template: literal, then a field's name and format; the last name may be
        None."""
        return tuple(self._parts)

    def read(self, line: bytes) -> dict[str, float] | None:
        """Return the numbers in a line; None: the line does not match."""
        if self.members:
            return self._read_members(line)
        text = line.decode("ascii", errors="replace").strip()
        found = self._pattern.fullmatch(text)
        if found is None:
            return None
        numbers = [float(group) for group in found.groups()]
        if not all(map(math.isfinite, numbers)):  # 1e999
            return None
        return dict(zip(self.fields, numbers, strict=True))

    def _read_members(self, line: bytes) -> dict[str, float] | None:
        try:
            found = json.loads(line)
        except ValueError:
            return None
        numbers = {}
        for name, field in self.members.items():
            value: object = found.get(name) if isinstance(found, dict) else None
            if isinstance(value, bool) or not isinstance(value, int | float):
                return None
            if not math.isfinite(value):
                return None
            if isinstance(field, str):
                numbers[field] = float(value)
            elif value != field:
                return None
        return numbers


def _check_field(name: str, spec: str, conversion: str | None, known: Collection[str]) -> None:
    if name not in known:
        raise ValueError(f"{{{name}}} is unknown (there are {', '.join(known)})")
    if conversion or not _FORMAT.fullmatch(spec):
        raise ValueError(f"{{{name}}}: a format is like :d, :.2f or :+05d")


class Lines:
    """Splitter of a stream of bytes at line ends. The first piece may be half a line and is
    dropped; so is a line longer than LINE_BYTES_MAX."""

    def __init__(self) -> None:
        self._tail = bytearray()
        self._whole = False

    @classmethod
    def whole(cls, data: bytes) -> list[bytes]:
        """Return the lines of a text that begins at a line's start."""
        lines = cls()
        lines.feed(b"\n")
        return lines.feed(data + b"\n")

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that these bytes complete, without their ends and without empty ones."""
        pieces = re.split(rb"[\r\n;]", data)
        lines = []
        for number, piece in enumerate(pieces):
            if number:
                if self._whole and self._tail:
                    lines.append(bytes(self._tail))
                self._tail.clear()
                self._whole = True
            self._tail += piece
            if len(self._tail) > LINE_BYTES_MAX:
                self._tail.clear()
                self._whole = False
        return lines
