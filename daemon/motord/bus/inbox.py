# SPDX-License-Identifier: Apache-2.0
"""From the threads of a bus's library to the event loop."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

from motord.bus.commands.gate import NotTaken

ASKED_MAX = 1024
"""Questions that wait to be begun."""
_ENDING = "motord-bus is ending"
_T = TypeVar("_T")


class Inbox(Generic[_T]):
    """The newest replaces the oldest."""

    def __init__(self, size: int, take: Callable[[_T], None]) -> None:
        self._items: deque[_T] = deque(maxlen=size)
        self._take = take
        self._woken = False
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self) -> None:
        """In the event loop that is to be woken."""
        self._loop = asyncio.get_running_loop()

    def put(self, item: _T) -> None:
        """From any thread."""
        self._items.append(item)
        if self._woken or self._loop is None or self._loop.is_closed():
            return
        self._woken = True
        self._loop.call_soon_threadsafe(self.empty)

    def empty(self) -> None:
        """Take all there is now, in the event loop."""
        self._woken = False  # before the last look: what comes after it wakes again
        while self._items:
            self._take(self._items.popleft())


class ThreadBridge:
    """What only the event loop may do, for threads that wait for the answer."""

    def __init__(self) -> None:
        self._asked: Inbox[tuple[Callable[[], Awaitable[Any]], Future[Any]]] = Inbox(
            ASKED_MAX, self._begin
        )
        self._tasks: asyncio.TaskGroup | None = None
        self._over = False

    async def run(self) -> None:
        """Until cancelled: callers that wait then, or come later, learn that it ends."""
        self._asked.open()
        async with asyncio.TaskGroup() as self._tasks:
            self._asked.empty()  # those before it
            try:
                await asyncio.Event().wait()
            finally:
                self._tasks, self._over = None, True
                self._asked.empty()  # a later caller sees that it is over

    def ask(self, make: Callable[[], Awaitable[_T]], within_s: float) -> _T:
        """From any thread but the loop's own. Raises NotTaken, also where there is no answer."""
        answer: Future[_T] = Future()
        self._asked.put((make, answer))
        if self._over:
            raise NotTaken(_ENDING)
        try:
            return answer.result(within_s)
        except TimeoutError:
            raise NotTaken(f"no answer within {within_s:g} s") from None

    def _begin(self, asked: tuple[Callable[[], Awaitable[Any]], Future[Any]]) -> None:
        make, answer = asked
        if self._tasks is None:
            answer.set_exception(NotTaken(_ENDING))
        else:
            self._tasks.create_task(_answered(make, answer))


async def _answered(make: Callable[[], Awaitable[_T]], answer: Future[_T]) -> None:
    try:
        answer.set_result(await make())
    except NotTaken as error:
        answer.set_exception(error)
    finally:
        if not answer.done():
            answer.set_exception(NotTaken(_ENDING))
