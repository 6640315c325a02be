# SPDX-License-Identifier: Apache-2.0
"""What a rule of the robot file finds."""

from __future__ import annotations

from dataclasses import dataclass

from motord.config.toml_lines import Path


@dataclass(frozen=True, slots=True)
class Finding:
    """An error, or a warning about what works but deserves a look.

    It stands on paths: it is reported at the first one, and not when any of them is wrong in
    itself.
    """

    paths: tuple[Path, ...]
    text: str
    warning: bool = False
