# SPDX-License-Identifier: Apache-2.0
"""The result of a rule of the robot file."""

from __future__ import annotations

from dataclasses import dataclass

from motord.config.toml_lines import Path


@dataclass(frozen=True, slots=True)
class Finding:
    """An error, or a warning about something that works but deserves a look.

    It is reported at the first of its paths; it is not reported if any of its paths is wrong by
    itself."""

    paths: tuple[Path, ...]
    text: str
    warning: bool = False
