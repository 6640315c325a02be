# SPDX-License-Identifier: Apache-2.0
"""The queue of requests outside the cycle: one for each drive at a time, each sent once, or not at
all if it is too late."""

from __future__ import annotations

import asyncio
import itertools
from collections import defaultdict, deque
from collections.abc import Callable

from motord_hal.base.clock import NS_PER_S, now_ns
from motord_hal.base.errors import BadReply, HalError, NoReply, PortError, Refused
from motord_hal.modbus.codec import EXCEPTION_TEXT
from motord_hal.realtime.line import Answer, AnswerKind, LineRequest, LineThread
from motord_hal.realtime.table import LineFrame, Seal
from motord_hal.servo.packets import DYNAMIXEL_ERRORS

ANSWER_ALLOWANCE_S = 1.0
"""Time that a caller waits beyond the line's own limit, because the event loop may be late."""

Check = Callable[[], None]
"""A function that raises HalError if a request must not be made any more."""


def always() -> None:
    """Do nothing: the Check of a request that is always allowed."""


class _Turn:
    """The turn to send a request to a drive. One caller has it at a time; urgent requests go first,
    the others in their order. A turn is passed on directly, so that a caller that comes back at
    once waits behind those that already wait."""

    def __init__(self) -> None:
        self._taken = False
        self._urgent: deque[asyncio.Future[None]] = deque()
        self._others: deque[asyncio.Future[None]] = deque()

    async def take(self, limit_s: float, *, urgent: bool) -> bool:
        """Wait for the turn, `limit_s` at most. Return False if it did not come."""
        if not self._taken:
            self._taken = True
            return True
        waiting = self._urgent if urgent else self._others
        mine: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiting.append(mine)
        kept = False
        try:
            await asyncio.wait([mine], timeout=limit_s)
            kept = mine.done()
        finally:
            if not mine.done():
                waiting.remove(mine)
            elif not kept:  # the turn came together with the cancellation
                self.give()
        return kept

    def give(self) -> None:
        """Pass the turn to the next caller that waits; without one it is free."""
        for waiting in (self._urgent, self._others):
            if waiting:
                waiting.popleft().set_result(None)
                return
        self._taken = False


class RequestQueue:
    """Sends requests from asyncio to the queue of one line's thread, and receives the answers."""

    def __init__(self, name: str, thread: LineThread, within_s: float) -> None:
        self._name = name
        self._thread = thread
        self._within_s = within_s
        """Longest time that a request waits for its slot; then it is dropped."""
        self._ids = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[Answer]] = {}
        self._turns: defaultdict[int, _Turn] = defaultdict(_Turn)
        """Number of the drive → its turn."""

    @property
    def limit_s(self) -> float:
        """Longest time until a request is sent or dropped."""
        return self._within_s

    async def send(
        self,
        drive: int,
        frame: LineFrame,
        turnaround_s: float,
        *,
        urgent: bool = False,
        check: Check = always,
    ) -> bytes:
        """Send a request and return the reply. Raise NoReply, BadReply, Refused, PortError, or the
        error of `check`.

        A request whose caller has given up may still be in the queue. The next request to the same
        drive waits for it, so that no later request is sent earlier. `check` is called at the last
        moment, because an urgent request may have gone before this one."""
        limit_s = self._within_s + ANSWER_ALLOWANCE_S
        turn = self._turns[drive]
        if not await turn.take(limit_s, urgent=urgent):
            raise NoReply(f"{self._name}: no answer to the request before this one")
        future = None
        try:
            check()
            request, future = self._hand_over(drive, frame, turnaround_s, urgent=urgent)
        finally:
            if future is None:
                turn.give()
        future.add_done_callback(lambda _: turn.give())
        if not (await asyncio.wait([future], timeout=limit_s))[0]:
            raise NoReply(f"{self._name}: no answer in {limit_s:.1f} s")
        return _reply(self._name, request, future.result())

    def _hand_over(
        self, drive: int, frame: LineFrame, turnaround_s: float, *, urgent: bool
    ) -> tuple[LineRequest, asyncio.Future[Answer]]:
        """Pass a request to the thread. Raise NoReply if the queue is full."""
        request = LineRequest(
            id=next(self._ids),
            drive=drive,
            frame=frame,
            expires_ns=now_ns() + round(self._within_s * NS_PER_S),
            turnaround_ns=round(turnaround_s * NS_PER_S),
            urgent=urgent,
        )
        if not self._thread.put_request(request):
            raise NoReply(f"{self._name}: too many requests wait for the wire")
        future: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._waiting[request.id] = future
        return request, future

    def take_answers(self) -> None:
        """Take the answers from the thread and pass them to their callers."""
        while (answer := self._thread.take_answer()) is not None:
            future = self._waiting.pop(answer.id, None)
            if future is not None:
                future.set_result(answer)

    def lose(self, error: HalError) -> None:
        """Raise `error` in all callers that wait, because the line is lost."""
        for future in self._waiting.values():
            future.set_exception(error)
            future.exception()  # its caller may have given up
        self._waiting.clear()


def _reply(name: str, request: LineRequest, answer: Answer) -> bytes:
    what = f"{name} {request.frame.request.hex(' ')}"
    took_ms = (answer.done_ns - answer.sent_ns) / 1e6
    match answer.kind:
        case AnswerKind.OK:
            return answer.reply
        case AnswerKind.NO_REPLY:
            raise NoReply(f"{what}: nothing within {took_ms:.1f} ms")
        case AnswerKind.BAD_REPLY:
            raise BadReply(f"{what}: what came is no answer")
        case AnswerKind.REFUSED:
            servo = request.frame.reply_seal is Seal.STUFFED
            text = exception_text(answer.exception, servo=servo)
            raise Refused(f"{what}: {text}", answer.exception)
        case AnswerKind.EXPIRED | AnswerKind.NEVER_SILENT:
            raise NoReply(f"{what}: too old to be sent")
        case AnswerKind.PORT:
            raise PortError(f"{name}: the port went away")


def exception_text(code: int, *, servo: bool = False) -> str:
    """Return the text for a Modbus exception code, or for the error number of a Dynamixel servo."""
    if servo:
        return f"{DYNAMIXEL_ERRORS.get(code, 'unknown error')} (error {code})"
    return f"{EXCEPTION_TEXT.get(code, 'unknown exception')} (exception {code})"
