# SPDX-License-Identifier: Apache-2.0
"""Functions that the readers of robot files and of drive profiles share: text, TOML, and every
problem of a file at its line."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path as File
from typing import Any, TypeVar

from pydantic import ValidationError

from motord.config.explain import Complaint, explain, mended, touched
from motord.config.finding import Finding
from motord.config.problems import ConfigError, Problem, dotted
from motord.config.schema import Node
from motord.config.syntax import explain_syntax
from motord.config.toml_lines import Path, line_of, lines_of
from motord_hal.base import bounded
from motord_hal.base.nearest import did_you_mean

_MENDING_ROUNDS = 3  # a renamed key may show a value that needs mending too
Found = TypeVar("Found")


class Places:
    """Where the file, or a --set option, gives each path."""

    def __init__(self, file: str, text: str) -> None:
        self.file = file
        self._text = text
        self.options: dict[Path, str] = {}

    @functools.cached_property
    def lines(self) -> dict[Path, int]:
        return lines_of(self._text)

    def problem(self, path: Path, text: str) -> Problem:
        for place, option in self.options.items():
            if path[: len(place)] == place:
                return Problem(option, 0, dotted(path), text)
        return Problem(self.file, line_of(self.lines, path), dotted(path), text)

    def sorted(
        self, found: Sequence[Finding], *, warnings: bool, more: Sequence[Complaint] = ()
    ) -> list[Problem]:
        """Return the errors or the warnings in the file's order."""
        chosen = [(hit.paths[0], hit.text) for hit in found if hit.warning == warnings]
        chosen += [(hit.path, hit.text) for hit in more]
        problems = dict.fromkeys(self.problem(path, text) for path, text in chosen)
        return sorted(problems, key=lambda problem: problem.line)


def read_text(file: File, where_from: str = "") -> str:
    """Return the content of the file; `where_from`: how to get one. Raises ConfigError."""
    try:
        return bounded.read(file).decode("utf-8-sig")  # Windows' Notepad writes a mark first
    except FileNotFoundError as error:
        near = did_you_mean(file.name, (path.name for path in file.parent.glob("*.toml")))
        cure = near or (where_from and f": {where_from}")
        problem = Problem(str(file), 0, "", f"cannot be read: {error.strerror}{cure}")
    except OSError as error:
        problem = Problem(str(file), 0, "", f"cannot be read: {error.strerror}")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        problem = Problem(str(file), line, "syntax", "is not UTF-8")
    raise ConfigError([problem])


def parse(file: File, text: str) -> dict[str, Any]:
    """Return the tables of a TOML text. Raises ConfigError."""
    try:
        return bounded.toml(text)
    except tomllib.TOMLDecodeError as error:
        line, words = explain_syntax(text, error)
        raise ConfigError([Problem(str(file), line, "syntax", words)]) from None
    except (ValueError, RecursionError) as error:  # thousands of digits, or of brackets
        raise ConfigError([Problem(str(file), 0, "syntax", str(error))]) from None


def all_problems(
    places: Places,
    data: dict[str, Any],
    error: ValidationError,
    schema: Node,
    validate: Callable[[dict[str, Any]], Found],
    rules: Callable[[Found], Sequence[Finding]],
) -> list[Problem]:
    """Return what pydantic has found in `data`, and what the rules find in a mended copy."""
    complaints = explain(schema, error.errors())
    mends, unsure = complaints, touched(complaints)
    copied = data
    for _ in range(_MENDING_ROUNDS):
        copied = mended(copied, mends)
        try:
            found = validate(copied)
        except ValidationError as again:
            mends = explain(schema, again.errors())
            unsure |= touched(mends)
            continue
        hits = [hit for hit in rules(found) if unsure.isdisjoint(hit.paths)]
        return places.sorted(hits, warnings=False, more=complaints)
    return places.sorted((), warnings=False, more=complaints)
