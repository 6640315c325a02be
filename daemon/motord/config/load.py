# SPDX-License-Identifier: Apache-2.0
"""From a file (and `--set` options) to a Robot, or to every problem at once, in this process."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any

from pydantic import ValidationError

from motord.config.explain import Complaint, explain, mended, touched
from motord.config.finding import Finding
from motord.config.problems import ConfigError, Problem, dotted
from motord.config.rules.checks import findings
from motord.config.sections.model import Robot
from motord.config.syntax import explain_syntax
from motord.config.toml_lines import Path, line_of, lines_of
from motord_hal.base import bounded

_MENDING_ROUNDS = 3  # a renamed key may show a value that needs mending too


def answer(
    path: str | File, overrides: Sequence[str], text: str | None
) -> Robot | tuple[Problem, ...]:
    """The robot, or every problem of its file: as `load_robot`."""
    try:
        return _robot(File(path), overrides, text)
    except ConfigError as error:
        return error.problems


def _robot(file: File, overrides: Sequence[str], text: str | None) -> Robot:
    text = _read(file) if text is None else text
    data = _parse(file, text)
    places = _Places(str(file), lines_of(text))
    for option in overrides:
        places.options[_override(data, option)] = f"--set {option}"
    try:
        robot = Robot.model_validate(data).read_from(file)
    except ValidationError as error:
        raise ConfigError(_all_problems(file, data, error, places)) from None
    found = findings(robot)
    if any(not hit.warning for hit in found):
        raise ConfigError(places.sorted(found, warnings=False))
    return robot.read_from(file, text, places.sorted(found, warnings=True), overrides)


class _Places:
    """Where in the file, or in which option, a path was said."""

    def __init__(self, file: str, lines: dict[Path, int]) -> None:
        self.file = file
        self.lines = lines
        self.options: dict[Path, str] = {}

    def problem(self, path: Path, text: str) -> Problem:
        for place, option in self.options.items():
            if path[: len(place)] == place:
                return Problem(option, 0, dotted(path), text)
        return Problem(self.file, line_of(self.lines, path), dotted(path), text)

    def sorted(
        self, found: Sequence[Finding], *, warnings: bool, more: Sequence[Complaint] = ()
    ) -> list[Problem]:
        """In the file's order, errors or warnings."""
        chosen = [(hit.paths[0], hit.text) for hit in found if hit.warning == warnings]
        chosen += [(hit.path, hit.text) for hit in more]
        problems = dict.fromkeys(self.problem(path, text) for path, text in chosen)
        return sorted(problems, key=lambda problem: problem.line)


def _all_problems(
    file: File, data: dict[str, Any], error: ValidationError, places: _Places
) -> list[Problem]:
    """What pydantic found, and what the checks find in a mended copy."""
    complaints = explain(error.errors())
    mends, unsure = complaints, touched(complaints)
    copied = data
    for _ in range(_MENDING_ROUNDS):
        copied = mended(copied, mends)
        try:
            robot = Robot.model_validate(copied)
        except ValidationError as again:
            mends = explain(again.errors())
            unsure |= touched(mends)
            continue
        found = [hit for hit in findings(robot.read_from(file)) if unsure.isdisjoint(hit.paths)]
        return places.sorted(found, warnings=False, more=complaints)
    return places.sorted((), warnings=False, more=complaints)


def _read(file: File) -> str:
    try:
        return bounded.read(file).decode()
    except OSError as error:
        problem = Problem(str(file), 0, "", f"cannot be read: {error.strerror}")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        problem = Problem(str(file), line, "syntax", "is not UTF-8")
    raise ConfigError([problem])


def _parse(file: File, text: str) -> dict[str, Any]:
    try:
        return bounded.toml(text)
    except tomllib.TOMLDecodeError as error:
        line, words = explain_syntax(text, error)
        raise ConfigError([Problem(str(file), line, "syntax", words)]) from None
    except (ValueError, RecursionError) as error:  # thousands of digits, or of brackets
        raise ConfigError([Problem(str(file), 0, "syntax", str(error))]) from None


def _override(data: dict[str, Any], option: str) -> Path:
    """Put KEY=VALUE into the data; returns the key as a path."""
    key, equals, value = option.partition("=")
    try:
        table: Any = bounded.toml(f"{key} = 0") if equals and "\n" not in key else None
    except tomllib.TOMLDecodeError:
        table = None
    if table is None:
        problem = Problem(f"--set {option}", 0, "", "is not KEY=VALUE, as in limits.linear_m_s=0.3")
        raise ConfigError([problem])
    path: list[str] = []
    while isinstance(table, dict):
        path.append(next(iter(table)))
        table = table[path[-1]]
    around = data
    for part in path[:-1]:
        if not isinstance(around.setdefault(part, {}), dict):
            around[part] = {}
        around = around[part]
    around[path[-1]] = _value(value)
    return tuple(path)


def _value(text: str) -> Any:
    try:
        return bounded.toml(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
