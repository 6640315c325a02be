# SPDX-License-Identifier: Apache-2.0
"""`load_robot`, which reads the robot file in this process or by a child."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from motord.base import validation
from motord.config.problems import ConfigError
from motord.config.sections.model import Robot


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
        found = validation.ask(path, tuple(overrides), text)
    if not isinstance(found, Robot):
        raise ConfigError(found)
    return found
