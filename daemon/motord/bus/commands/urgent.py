# SPDX-License-Identifier: Apache-2.0
"""A stop or an emergency stop from a sender that does not wait for an answer: it is repeated until
the daemon answers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.link import reason
from motord.client import ClientError, Refused

AGAIN_S = 0.1

_log = logging.getLogger(__name__)


class Urgent:
    """Requests of one urgent method by one input. `ask` never waits; a request during a call leads
    to one more call after it."""

    def __init__(self, name: str, method: str, call: Callable[..., Awaitable[Any]]) -> None:
        """`call` raises Refused and ClientError: see `Runtime.call`."""
        self._input, self._what = f"input.{name}", f"input.{name}: {method}"
        self._method, self._call = method, call
        self._asked = asyncio.Event()
        self._params: dict[str, str] = {}
        self._voice, self._trouble = RateLimitedLog(_log), RateLimitedLog(_log)

    def ask(self, why: str) -> None:
        """Request the method. `why` is logged, and becomes the reason of an emergency stop."""
        self._voice.say(f"{self._what} {why}")
        if self._method == "estop":
            self._params = reason(f"{self._input}: {why}")
        self._asked.set()

    async def run(self) -> None:
        """Call the daemon for each request, until cancelled."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            if not await self._answered():
                self._asked.set()
                await asyncio.sleep(AGAIN_S)

    async def _answered(self) -> bool:
        try:
            await self._call(self._method, **self._params)
        except Refused as error:
            self._trouble.say(f"{self._what}: refused: {error}")
        except ClientError as error:
            self._trouble.say(f"{self._what}: {error}: repeated until the daemon answers")
            return False
        return True
