# SPDX-License-Identifier: Apache-2.0
"""Reader of a robot file (and `--set` options) in this process: a Robot, or every problem at
once."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path as File
from typing import Any

from pydantic import ValidationError

from motord.config.finding import Finding
from motord.config.problems import ConfigError, Problem
from motord.config.reading import Places, all_problems, parse, read_text
from motord.config.robot_file import ATTACHED_FILE, ATTACHED_REST
from motord.config.rules.checks import findings
from motord.config.schema import robot_schema
from motord.config.sections.model import Robot, profiles_of
from motord.config.toml_lines import Path
from motord_hal.base import bounded
from motord_hal.drives.profile import DriveProfile

WHERE_FROM = "motord init writes a robot file, motord robots prints examples"


def answer(
    path: str | File, overrides: Sequence[str], text: str | None
) -> Robot | tuple[Problem, ...]:
    """Return the robot, or every problem of its file. The arguments are those of `load_robot`."""
    try:
        return _robot(File(path), overrides, text)
    except ConfigError as error:
        return error.problems


def recorded(attached: Mapping[str, bytes]) -> tuple[Robot, dict[str, DriveProfile]]:
    """Return the robot of a recording, and the profiles of its drives, from its attached files
    (`motord.config.robot_file.attached`). The tables are validated. Nothing checks that drives and
    rules fit: the core checks the numbers that follow. Raises KeyError without those files,
    ValueError for a file that cannot be used."""
    text = attached[ATTACHED_FILE].decode()
    rest = json.loads(attached[ATTACHED_REST])
    data = parse(File(ATTACHED_FILE), text)
    for option in rest["set"]:
        _override(data, option)
    try:
        robot = Robot.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise ValueError(f"{key}: {first['msg']}") from None
    return robot, profiles_of(json.dumps(rest["drives"]))


def _robot(file: File, overrides: Sequence[str], text: str | None) -> Robot:
    text = read_text(file, WHERE_FROM) if text is None else text
    data = parse(file, text)
    places = Places(str(file), text)
    for option in overrides:
        places.options[_override(data, option)] = f"--set {option}"
    try:
        robot = Robot.model_validate(data).read_from(file)
    except ValidationError as error:

        def rules(mended: Robot) -> list[Finding]:
            return findings(mended.read_from(file))[0]

        problems = all_problems(places, data, error, robot_schema(), Robot.model_validate, rules)
        raise ConfigError(problems) from None
    found, profiles = findings(robot)
    if any(not hit.warning for hit in found):
        raise ConfigError(places.sorted(found, warnings=False))
    warnings = places.sorted(found, warnings=True)
    return robot.read_from(file, text, warnings, overrides, profiles)


def _override(data: dict[str, Any], option: str) -> Path:
    """Put KEY=VALUE into the data; return the key as a path."""
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
