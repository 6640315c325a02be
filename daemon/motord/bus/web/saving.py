# SPDX-License-Identifier: Apache-2.0
"""Saves limits by `motord params save`: one implementation, in a process of its own, which may load
what this one does without."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

from motord.api.deadline import within
from motord.bus.commands.gate import NotTaken

WITHIN_S = 30.0


async def save(local_socket: Path, *, dry_run: bool) -> dict[str, Any]:
    """What was saved, or would be: the answer of the command. Raises NotTaken with its reason."""
    how = "--dry-run" if dry_run else "--yes"
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "motord", "params", "save", how, "--json"),
        *("--socket", str(local_socket)),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        async with within(WITHIN_S):
            answer, words = await child.communicate()
    except TimeoutError:
        raise NotTaken(f"motord params save did not end within {WITHIN_S:g} s") from None
    finally:
        if child.returncode is None:
            child.kill()
    if child.returncode:
        text = words.decode(errors="replace").strip().removeprefix("Error: ")
        raise NotTaken(text or "motord params save failed")
    found: dict[str, Any] = json.loads(answer)
    return found
