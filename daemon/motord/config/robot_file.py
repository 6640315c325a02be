# SPDX-License-Identifier: Apache-2.0
"""`load_robot`, wherever the robot file is read."""

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
    (else it is taken for a text); `text` is taken for what is in the file. Raises ConfigError with
    every problem; what only deserves a look is in `robot.warnings`."""
    if validation.HERE:
        from motord.config.load import answer

        found = answer(path, overrides, text)
    else:
        found = validation.ask(path, tuple(overrides), text)
    if not isinstance(found, Robot):
        raise ConfigError(found)
    return found
