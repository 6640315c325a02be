# SPDX-License-Identifier: Apache-2.0
"""`load_robot`, which reads the robot file in this process or by a child."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from motord.base import validation
from motord.config import transfer
from motord.config.problems import ConfigError, Problem
from motord.config.sections.model import Robot
from motord.config.sections.section import Section

ATTACHED_FILE, ATTACHED_REST = "robot.toml", "robot.json"
"""Files that a recording with a journal has attached: the robot file, and what belongs to it."""
_UNREADABLE = "the process that reads the robot file has answered what is no robot"


def load_robot(
    path: str | Path, overrides: Sequence[str] = (), *, text: str | None = None
) -> Robot:
    """Read a robot file. `overrides` are KEY=VALUE: a dotted key, and a value as TOML writes it
    (else it is taken as a string); `text` replaces the file's content. Raises ConfigError with
    every problem; problems that only deserve a look are in `robot.warnings`."""
    if validation.HERE:
        from motord.config.load import answer

        found = answer(path, overrides, text)
    else:
        found = _received(validation.ask(str(path), tuple(overrides), text))
    if not isinstance(found, Robot):
        raise ConfigError(found)
    return found


def handed_over(robot: Robot) -> bytes:
    """Return a robot as another process takes it over by `taken_over`."""
    return transfer.dumps(robot).encode()


def taken_over(text: bytes) -> Robot:
    """Return the robot of a process that has read its file. Raises RuntimeError for other text."""
    found = _received(text)
    if not isinstance(found, Robot):
        raise RuntimeError(_UNREADABLE)
    return found


def attached(robot: Robot) -> dict[str, bytes]:
    """Return what a recording needs of the robot, so that a replay sets up the same core
    (`motord.config.load.recorded`), as files by their names."""
    rest = f'{{"set":{json.dumps(robot.overrides)},"drives":{robot.profiles_text}}}'
    return {ATTACHED_FILE: robot.text.encode(), ATTACHED_REST: rest.encode()}


def _received(text: bytes) -> Any:
    try:
        return transfer.loads(text, transfer.classes_of(Section, Problem))
    except ValueError as error:
        raise RuntimeError(_UNREADABLE) from error
