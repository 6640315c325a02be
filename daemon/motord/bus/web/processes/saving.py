# SPDX-License-Identifier: Apache-2.0
"""Saves limits by `motord params save`, so that there is one implementation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from motord.bus.web.processes.command import answer

WITHIN_S = 30.0


async def save(local_socket: Path, *, dry_run: bool) -> dict[str, Any]:
    """Save the limits, or with `dry_run` only compare; return the answer of the command. Raises
    NotTaken with its reason."""
    how = "--dry-run" if dry_run else "--yes"
    place = ("--socket", str(local_socket))
    found: dict[str, Any] = await answer("params", "save", how, *place, within_s=WITHIN_S)
    return found
