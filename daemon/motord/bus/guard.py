# SPDX-License-Identifier: Apache-2.0
"""Starts an adapter that fails again, without an effect on other buses and inputs."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import MutableMapping

from motord.bus.adapters import Adapter
from motord_hal.base.tasks import TaskGroup

AGAIN_MIN_S, AGAIN_MAX_S = 0.5, 30.0
WELL_AFTER_S = 60.0
"""An adapter that has worked for this long is restarted soon after a failure, and the failure is
logged."""

_log = logging.getLogger(__name__)


async def keep(where: str, adapter: Adapter, failures: MutableMapping[str, int]) -> None:
    """Run an adapter until it ends by itself or is cancelled. Count each failure under `where`, but
    log only the first of a series. MemoryError is raised: the whole process has no room."""
    again_s, failing = AGAIN_MIN_S, False
    while True:
        began_s = time.monotonic()
        async with TaskGroup() as tasks:
            life = tasks.create_task(_life(adapter))
        error = asyncio.CancelledError("by itself") if life.cancelled() else life.result()
        if error is None:
            return
        failures[where] = failures.get(where, 0) + 1
        if time.monotonic() - began_s > WELL_AFTER_S:
            again_s, failing = AGAIN_MIN_S, False
        if not failing:
            failing = True
            text = "%s failed and starts again; more failures are counted, not logged: %s: %s"
            _log.error(text, where, type(error).__name__, error, exc_info=error)
        await asyncio.sleep(again_s)
        again_s = min(2.0 * again_s, AGAIN_MAX_S)


async def _life(adapter: Adapter) -> BaseException | None:
    """Run the adapter and return its failure; None: it has ended by itself. Runs in a task of its
    own: until Python 3.12 a group leaves its task marked as one that is to be cancelled when a
    member fails while the group ends."""
    error = None
    try:
        await adapter.run()
    except* MemoryError:
        raise
    except* Exception as errors:  # noqa: BLE001  code of another package may raise anything
        error = first(errors)
    return error


def first(errors: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the first error of a group, for the log."""
    error: BaseException = errors
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def raise_if_cancelled() -> None:
    """Raise CancelledError if this task was cancelled: a client library may answer a cancellation
    with an error of its own."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError
