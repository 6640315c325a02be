# SPDX-License-Identifier: Apache-2.0
"""Requests outside the cycle: one a drive at a time, each sent once, in time or not at all."""

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
"""How much longer than the line a caller waits for an answer: the event loop may be late."""

Check = Callable[[], None]
"""Raises HalError if a request must not be made any more."""


def always() -> None:
    """The Check of a request that is always allowed."""


class _Turn:
    """Turns to send a request: one at a time, urgent requests first, else in their order. A turn is
    handed over, so that a caller that returns at once waits behind those already waiting."""

    def __init__(self) -> None:
        self._taken = False
        self._urgent: deque[asyncio.Future[None]] = deque()
        self._others: deque[asyncio.Future[None]] = deque()

    async def take(self, limit_s: float, *, urgent: bool) -> bool:
        """False: it did not come within the limit."""
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
            elif not kept:  # it came together with the cancellation
                self.give()
        return kept

    def give(self) -> None:
        """Hand the turn over."""
        for waiting in (self._urgent, self._others):
            if waiting:
                waiting.popleft().set_result(None)
                return
        self._taken = False


class RequestQueue:
    """The queue of one line's thread, seen from asyncio."""

    def __init__(self, name: str, thread: LineThread, within_s: float) -> None:
        self._name = name
        self._thread = thread
        self._within_s = within_s
        """How long a request may wait for its slot; then it is dropped."""
        self._ids = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[Answer]] = {}
        self._turns: defaultdict[int, _Turn] = defaultdict(_Turn)
        """By drive."""

    @property
    def limit_s(self) -> float:
        """Longest time from the request to its sending."""
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
        """The reply. Raises NoReply, BadReply, Refused, PortError, and what `check` raises.

        A request whose caller has given up may still be in the queue, and the next one of its drive
        waits for it: a later request is never sent earlier. `check` is called when nothing can come
        between it and the request: an urgent one may have overtaken it before."""
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
        """Pass it to the thread. Raises NoReply if the queue is full."""
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
        """Pass answers to their callers."""
        while (answer := self._thread.take_answer()) is not None:
            future = self._waiting.pop(answer.id, None)
            if future is not None:
                future.set_result(answer)

    def lose(self, error: HalError) -> None:
        """The line is lost: no caller gets an answer any more."""
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
    """A Modbus exception code in words, or a Dynamixel servo's error number."""
    if servo:
        return f"{DYNAMIXEL_ERRORS.get(code, 'unknown error')} (error {code})"
    return f"{EXCEPTION_TEXT.get(code, 'unknown exception')} (exception {code})"
