# SPDX-License-Identifier: Apache-2.0
"""Groups of tasks that can fail while their owner goes on."""

from __future__ import annotations

import asyncio
import sys
from types import TracebackType

_LEAVES_ITS_CANCELLATION = sys.version_info < (3, 13)


class TaskGroup(asyncio.TaskGroup):
    """asyncio.TaskGroup that takes its own cancellation of the owner back.

    A group cancels its owner when a member fails. If that happens while the group already waits for
    its members, Python 3.11 and 3.12 leave the request pending: the owner counts as cancelled for
    ever, a time limit around the group raises CancelledError instead of TimeoutError, and a line
    that is lost ends instead of being opened again.
    Source: github.com/python/cpython/issues/116720."""

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        owner = asyncio.current_task()
        taken_back = self._requested
        try:
            await super().__aexit__(kind, error, trace)
        finally:
            if _LEAVES_ITS_CANCELLATION and owner and self._requested and not taken_back:
                owner.uncancel()

    @property
    def _requested(self) -> bool:
        """Whether the group has cancelled its owner: asyncio has no public name for it."""
        requested: bool = self._parent_cancel_requested  # type: ignore[attr-defined]
        return requested
