# SPDX-License-Identifier: Apache-2.0
"""Findings of the checks of a drive profile."""

from __future__ import annotations

import re

from motord.config.finding import Finding
from motord.config.toml_lines import Path

_PART = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


class Problems:
    """Findings in the order in which they were added."""

    def __init__(self) -> None:
        self.found: list[Finding] = []

    def add(self, key: str, problem: str) -> None:
        """Add a problem. `key` is a path as `dotted` writes it."""
        self.found.append(Finding((_path(key),), problem))


def _path(key: str) -> Path:
    return tuple(int(index) if index else name for name, index in _PART.findall(key))
