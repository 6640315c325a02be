# SPDX-License-Identifier: Apache-2.0
"""Reading a TOML file so that every problem in it is found at once and named with its line."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from motord_hal.base.nearest import did_you_mean

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""\s*([A-Za-z0-9_\-."']+)\s*=""")
_ELEMENT = re.compile(r"\s*\{")


def line_index(text: str) -> dict[str, int]:
    """Dotted key → line number, for tables, keys, and inline tables that begin a line of their own
    in an array (`steps.arm.1`)."""
    lines: dict[str, int] = {}
    counts: dict[str, int] = {}
    table = array = ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            table, array = header.group(2).replace('"', ""), ""
            if header.group(1) == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = f"{table}.{counts[table]}"
            lines.setdefault(table, number)
        elif array and _ELEMENT.match(line):
            counts[array] += 1
            lines[f"{array}.{counts[array]}"] = number
        elif key := _KEY.match(line):
            array = ".".join(filter(None, (table, key.group(1).strip("\"'"))))
            counts[array] = -1
            lines.setdefault(array, number)
    return lines


class Problems:
    """Collects `file:line: key: problem` rows in the order in which they were found."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.rows: list[str] = []
        self._lines = line_index(text)

    def add(self, key: str, problem: str) -> None:
        """Names the line of the key, else of the nearest table around it, else the first inside."""
        near = key
        while near and near not in self._lines:
            near = near.rpartition(".")[0]
        inside = (row for name, row in self._lines.items() if name.startswith(f"{key}."))
        number = self._lines[near] if near else min(inside, default=None)
        line = f":{number}" if number else ""
        self.rows.append(f"{self.path}{line}: {key}: {problem}")


class Table:
    """One table of the file under its dotted name. Each reader method takes a key, complains where
    it is wrong and then returns something harmless, so that reading can go on."""

    def __init__(self, name: str, values: Mapping[str, object], problems: Problems) -> None:
        self.name = name
        self.problems = problems
        self._values = values
        self._asked: set[str] = set()

    def path(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key

    def complain(self, key: str, problem: str) -> None:
        self.problems.add(self.path(key), problem)

    def _take(self, key: str, *, required: bool) -> object | None:
        self._asked.add(key)
        if key not in self._values and required:
            self.complain(key, "is missing")
        return self._values.get(key)

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def without(self, *keys: str) -> dict[str, object]:
        """All of it as it stands in the file, but for some keys."""
        return {name: value for name, value in self._values.items() if name not in keys}

    def text(self, key: str, default: str | None = None, choices: Iterable[str] = ()) -> str:
        """A string that is not empty; without a default the key must be there."""
        value = self._take(key, required=default is None)
        if value is None:
            return default or ""
        choices = list(choices)
        if not isinstance(value, str) or (not value.strip() and "" not in choices):
            self.complain(key, f"{value!r} must be a string that is not empty")
            return default or ""
        if choices and value not in choices:
            allowed = ", ".join(f'"{choice}"' for choice in choices)
            self.complain(key, f'"{value}" is not one of {allowed}{did_you_mean(value, choices)}')
            return default or ""
        return value

    def number(
        self, key: str, low: float, high: float, default: float | None = None, unit: str = ""
    ) -> float:
        """A finite number in low..high; without a default the key must be there."""
        value = self._take(key, required=default is None)
        fallback = low if default is None else default
        if value is None:
            return fallback
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.complain(key, f"{value!r} must be a number")
            return fallback
        if not math.isfinite(value) or not low <= value <= high:
            self.complain(
                key, f"{value} is out of range ({low:g} to {high:g} {unit}".rstrip() + ")"
            )
            return fallback
        return value

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """A whole number in low..high; without a default the key must be there."""
        value = self._take(key, required=default is None)
        fallback = low if default is None else default
        if value is None:
            return fallback
        if isinstance(value, bool) or not isinstance(value, int):
            self.complain(key, f"{value!r} must be a whole number")
            return fallback
        if not low <= value <= high:
            self.complain(key, f"{value} is out of range ({low} to {high})")
            return fallback
        return value

    def one_of(self, key: str, choices: tuple[int, ...], default: int | None = None) -> int:
        """One of some whole numbers."""
        value = self.integer(key, min(choices), max(choices), default)
        if value not in choices:
            self.complain(key, f"{value} is not one of {', '.join(map(str, choices))}")
            return choices[0]
        return value

    def integers(self, key: str, low: int, high: int) -> list[int]:
        """An array of whole numbers in low..high; missing is empty."""
        value = self._take(key, required=False)
        if value is None:
            return []
        good = isinstance(value, list) and all(
            isinstance(one, int) and not isinstance(one, bool) and low <= one <= high
            for one in value
        )
        if not isinstance(value, list) or not good:
            self.complain(key, f"must be an array of whole numbers, each {low} to {high}")
            return []
        return value

    def flag(self, key: str, *, default: bool) -> bool:
        """true or false."""
        value = self._take(key, required=False)
        if value is None:
            return default
        if not isinstance(value, bool):
            self.complain(key, f"{value!r} must be true or false")
            return default
        return value

    def table(self, key: str, *, required: bool = True) -> Table:
        """A table below this one; an empty one where it is missing or none."""
        value = self._take(key, required=required)
        if value is not None and not isinstance(value, dict):
            self.complain(key, "must be a table")
        return Table(self.path(key), value if isinstance(value, dict) else {}, self.problems)

    def is_table(self, key: str) -> bool:
        return isinstance(self._values.get(key), dict)

    def tables(self, key: str) -> list[Table]:
        """An array of tables below this one; missing is empty."""
        value = self._take(key, required=False)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
            self.complain(key, "must be an array of tables")
            return []
        path = self.path(key)
        return [Table(f"{path}.{index}", row, self.problems) for index, row in enumerate(value)]

    def finish(self) -> None:
        """Complain about every key that nobody asked for."""
        for key in self._values:
            if key not in self._asked:
                self.complain(key, f"unknown key{did_you_mean(key, self._asked)}")
