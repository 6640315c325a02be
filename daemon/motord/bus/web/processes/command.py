# SPDX-License-Identifier: Apache-2.0
"""Runs commands and modules of motord as processes of their own: they may load packages that
motord-bus does without, and may be slow."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Mapping
from typing import Any

from motord.api.deadline import within
from motord.base.python_command import module_command
from motord.bus.commands.gate import NotTaken
from motord.bus.messages import json_form
from motord_hal.base.tasks import TaskGroup

NICENESS = 19
"""Lowest priority: every other process runs first."""

_log = logging.getLogger(__name__)


class TaskOwner:
    """Base of objects whose tasks end with them."""

    _tasks: TaskGroup | None = None

    async def run(self) -> None:
        """Keep the group of the tasks until cancelled."""
        async with TaskGroup() as self._tasks:
            try:
                await asyncio.Event().wait()
            finally:
                self._tasks = None


async def started(what: str, module: str, *arguments: str, **options: Any) -> Process:
    """Start `python -m MODULE ARGUMENTS`, with `options` of create_subprocess_exec. Raises
    NotTaken, which names `what`, if this machine has no process, memory or descriptor left for
    it."""
    try:
        return await asyncio.create_subprocess_exec(*module_command(module, *arguments), **options)
    except OSError as error:
        _log.warning("%s cannot be started: %s", what, error)
        raise NotTaken(f"{what} cannot be started: {error.strerror or error}") from error


@contextlib.asynccontextmanager
async def running(
    *arguments: str, module: str = "motord", stdin: int = DEVNULL
) -> AsyncIterator[Process]:
    """Run `python -m MODULE ARGUMENTS`, with pipes from its output; kill it at the end if it still
    runs. Raises NotTaken if it cannot be started."""
    what = f"motord {arguments[0]}" if arguments else "a process for the request"
    child = await started(what, module, *arguments, stdin=stdin, stdout=PIPE, stderr=PIPE)
    try:
        with contextlib.suppress(OSError):  # it has ended
            os.setpriority(os.PRIO_PROCESS, child.pid, NICENESS)
        yield child
    finally:
        if child.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                child.kill()


async def answer(*arguments: str, within_s: float) -> Any:
    """Return what `motord ARGUMENTS --json` prints, whatever its exit status. Raises NotTaken if it
    cannot be started, and if it prints an error or nothing that can be read."""
    try:
        async with within(within_s), running(*arguments, "--json") as child:
            found, words = await child.communicate()
    except TimeoutError:
        raise NotTaken(f"motord {arguments[0]} did not end within {within_s:g} s") from None
    if child.returncode and not found:
        raise NotTaken(reason(words, arguments[0]))
    report = _decoded(found, f"motord {arguments[0]}")
    if child.returncode and isinstance(report, dict) and "error" in report:
        raise NotTaken(report["error"])
    return report


async def asked(module: str, request: Mapping[str, Any], *, within_s: float) -> Any:
    """Return what a module answers to a request on its standard input, both in JSON. Raises
    NotTaken."""
    try:
        async with within(within_s), running(module=module, stdin=PIPE) as child:
            found, words = await child.communicate(json.dumps(request).encode())
    except TimeoutError:
        raise NotTaken(f"the robot did not answer within {within_s:g} s") from None
    if child.returncode:
        _log.error("%s: %s", module, words.decode(errors="replace").strip())
        raise NotTaken("the request failed: see the log of motord-bus")
    return _decoded(found, module)


def _decoded(found: bytes, what: str) -> Any:
    """Decode an answer. Raises NotTaken for output that is no JSON: the process was killed while it
    printed, perhaps."""
    try:
        return json_form.decode(found)
    except ValueError as error:
        _log.error("%s printed what cannot be read: %s", what, error)
        raise NotTaken(f"{what} did not print its answer to the end: try again") from None


def reason(words: bytes, command: str) -> str:
    """Return why a command failed, from its standard error."""
    text = words.decode(errors="replace").strip().removeprefix("Error: ")
    return text or f"motord {command} failed"
