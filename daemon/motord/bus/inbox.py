# SPDX-License-Identifier: Apache-2.0
"""Passes items from the threads of a bus's library to the event loop."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

from motord.bus.commands.gate import NotTaken
from motord_hal.base.tasks import TaskGroup

ASKED_MAX = 1024
"""Largest number of requests that wait to be started."""
_ENDING = "motord-bus is ending"
_T = TypeVar("_T")


class Inbox(Generic[_T]):
    """A queue from any thread to the event loop; when it is full, the newest item replaces the
    oldest."""

    def __init__(self, size: int, take: Callable[[_T], None]) -> None:
        self._items: deque[_T] = deque(maxlen=size)
        self._take = take
        self._woken = False
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self) -> None:
        """Start passing items to the event loop that calls this."""
        self._loop = asyncio.get_running_loop()

    def put(self, item: _T) -> None:
        """Add an item, from any thread."""
        self._items.append(item)
        if self._woken or self._loop is None or self._loop.is_closed():
            return
        self._woken = True
        self._loop.call_soon_threadsafe(self.empty)

    def empty(self) -> None:
        """Take all items, in the event loop."""
        self._woken = False  # before the last look: later items wake the loop again
        while self._items:
            self._take(self._items.popleft())


class ThreadBridge:
    """Runs coroutines in the event loop for threads that wait for the answer."""

    def __init__(self) -> None:
        self._asked: Inbox[tuple[Callable[[], Awaitable[Any]], Future[Any]]] = Inbox(
            ASKED_MAX, self._begin
        )
        self._tasks: TaskGroup | None = None
        self._over = False

    async def run(self) -> None:
        """Serve callers until cancelled. Callers that wait then, or call later, get NotTaken."""
        self._asked.open()
        async with TaskGroup() as self._tasks:
            self._asked.empty()  # requests from before this call
            try:
                await asyncio.Event().wait()
            finally:
                self._tasks, self._over = None, True
                self._asked.empty()  # later callers get NotTaken

    def ask(self, make: Callable[[], Awaitable[_T]], within_s: float) -> _T:
        """Run `make` in the event loop and return its answer, from any thread but the loop's own.
        Raises NotTaken, also if there is no answer in time."""
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
