# SPDX-License-Identifier: Apache-2.0
"""Line numbers of the keys of a TOML text. No TOML library reports them: this reader does, for
texts that tomllib has already accepted (https://toml.io/en/v1.0.0)."""

from __future__ import annotations

import tomllib

from motord_hal.base.bounded import TOKEN

Path = tuple[str | int, ...]
"""Keys, and indices in arrays, from the top: ("joint", "left", "unit")."""


def lines_of(text: str) -> dict[Path, int]:
    """Return the line number, from 1, of every table, key and array element."""
    return _Reader(text).document()


def line_of(lines: dict[Path, int], path: Path) -> int:
    """Return the line of the path, or of the nearest table around it; 1: there is neither."""
    return next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), 1)


class _Reader:
    """Reader of the tokens, once, left to right; `self.tokens[-1]` is the next one."""

    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, int]] = []
        line = 1
        for match in TOKEN.finditer(text):
            if match.lastgroup != "skip":
                self.tokens.append((match[0], line))
            line += match[0].count("\n")
        self.tokens.reverse()
        self.lines: dict[Path, int] = {}
        self.last: dict[Path, int] = {}  # index of the newest element of each array of tables

    def skip(self, *marks: str) -> None:
        while self.tokens and self.tokens[-1][0] in marks:
            self.tokens.pop()

    def document(self) -> dict[Path, int]:
        table: Path = ()
        self.skip("\n")
        while self.tokens:
            if self.tokens[-1][0] == "[":
                table = self.header()
            else:
                self.pair(table)
            self.skip("\n")
        return self.lines

    def header(self) -> Path:
        self.tokens.pop()
        is_array = self.tokens[-1][0] == "["
        self.skip("[")
        path = self.key((), is_array=is_array)
        self.skip("]")
        return path

    def key(self, start: Path, *, is_array: bool = False) -> Path:
        path = start
        while self.tokens[-1][0] not in ("=", "]"):
            word, line = self.tokens.pop()
            if word == ".":
                continue
            path = (*path, next(iter(tomllib.loads(f"{word} = 0"))))
            if is_array and self.tokens[-1][0] == "]":
                self.last[path] = self.last.get(path, -1) + 1
            if not start and path in self.last:
                path = (*path, self.last[path])
            self.lines.setdefault(path, line)
            self.lines.setdefault(path[:-1] if isinstance(path[-1], int) else path, line)
        return path

    def pair(self, table: Path) -> None:
        path = self.key(table)
        self.skip("=")
        self.value(path)

    def value(self, path: Path) -> None:
        word, _ = self.tokens.pop()
        if word == "{":
            while self.tokens[-1][0] != "}":
                self.pair(path)
                self.skip(",", "\n")
            self.tokens.pop()
        elif word == "[":
            self.skip("\n")
            index = 0
            while self.tokens[-1][0] != "]":
                self.lines[*path, index] = self.tokens[-1][1]
                self.value((*path, index))
                self.skip(",", "\n")
                index += 1
            self.tokens.pop()
        else:
            while self.tokens and self.tokens[-1][0] not in ("\n", ",", "]", "}"):
                self.tokens.pop()
