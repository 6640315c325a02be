# SPDX-License-Identifier: Apache-2.0
"""Runs a helper process that ends with the measurement."""

from __future__ import annotations

import asyncio
import contextlib
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncIterator, Sequence

from motord_hal.base.clock import within

END_DEADLINE_S = 10.0


@contextlib.asynccontextmanager
async def running(command: Sequence[str], pass_fds: Sequence[int] = ()) -> AsyncIterator[Process]:
    """Run a process in this block, with pipes for stdout and stderr; kill it at the end if it still
    runs. It has its own session, so that Ctrl-C goes only to the measurement, which ends it."""
    process = await asyncio.create_subprocess_exec(
        *command,
        stdin=DEVNULL,
        stdout=PIPE,
        stderr=PIPE,
        pass_fds=tuple(pass_fds),
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            async with within(END_DEADLINE_S):
                await process.communicate()
