# SPDX-License-Identifier: Apache-2.0
"""One page that is connected: what it is sent, and what it requests.

Frames that a page has not acknowledged fill the buffers of a slow link, and the newest one would
arrive last. So no more than WINDOW_S of them are in transit: meanwhile only the newest is kept.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from aiohttp import WSMsgType, web

from motord.api.local_rpc import NEEDS_FORCE
from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.gate import URGENT, NotTaken, short, tag
from motord.bus.messages import json_form
from motord.bus.web.frames import (
    ACKNOWLEDGE,
    DRIVE,
    PRESENT,
    RELEASE,
    drive_frame,
    number_of,
    present_frame,
)
from motord.bus.web.processes.commissioning import Commissioning
from motord.bus.web.seat import Driver, Seat
from motord.client import ClientError
from motord_hal.base.tasks import TaskGroup

WINDOW_S = 0.75
RATE_MIN_HZ = 0.5
TEXTS_MAX = 256
"""Largest number of messages that a page has not read yet; with one more its connection is
ended."""
CALLS_MAX = 8
CALLS_HZ, COMMANDS_HZ = 20.0, 100.0
COMPLAIN_AGAIN_S = 0.5
NEVER_TOO_MANY = (*URGENT, "commission.stop")
BUSY = "too many requests: try again"

_log = logging.getLogger(__name__)
_unchecked = RateLimitedLog(_log)

Serve = Callable[["Viewer", str, Mapping[str, Any]], Awaitable[Any]]
"""Function that answers a call of a page. Raises NotTaken and ClientError."""


class Allowance:
    """Limits a rate: at most `rate_hz` a second, and as many at once."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = self._left = rate_hz
        self._looked_s = time.monotonic()

    def take(self) -> bool:
        """Return whether one more is permitted now."""
        now_s = time.monotonic()
        more = (now_s - self._looked_s) * self._rate_hz
        self._left, self._looked_s = min(self._rate_hz, self._left + more), now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Viewer:
    """A page that is connected. Its methods `offer` and `say` never wait."""

    def __init__(
        self,
        connection: web.WebSocketResponse,
        name: str,
        rate_hz: float,
        seat: Seat | None,
        commissioning: Commissioning,
        serve: Serve,
    ) -> None:
        """`seat`: the driver's place; None for a page that only watches."""
        self.name = name
        self.may_command = seat is not None
        self.has_token = False
        """Whether it has shown the token."""
        self.may_write = False
        """Whether it may write any text as the robot file, not just what a procedure has
        measured."""
        self._connection = connection
        self._seat, self._commissioning, self._serve = seat, commissioning, serve
        self._driver = Driver(name)
        self._rate_max_hz = self.rate_hz = rate_hz
        self.dropped = 0
        """Number of frames that it did not get, because its link is slow."""
        self._due_ns = 0
        self._newest: tuple[int, bytes] | None = None
        self._texts: deque[str] = deque()
        self._sent: deque[tuple[int, float]] = deque()
        """Frames that the page has not acknowledged: number, and time of sending."""
        self._arrived = asyncio.Event()
        self._calls = 0
        self._asking, self._commanding = Allowance(CALLS_HZ), Allowance(COMMANDS_HZ)
        self._complained_s = -math.inf

    # ------------------------------------------------------------------------------------ sending
    def due(self, stamp_ns: int) -> bool:
        """Return whether it is time for the page's next frame, by the state's stamp."""
        return stamp_ns >= self._due_ns

    def offer(self, number: int, frame: bytes, stamp_ns: int) -> bool:
        """Keep a frame for sending; return whether an older one was lost for it."""
        self._due_ns = max(self._due_ns + round(1e9 / self.rate_hz), stamp_ns)
        lost = self._newest is not None
        self.dropped += lost
        self._newest = number, frame
        self._arrived.set()
        return lost

    def say(self, text: str) -> None:
        """Add a JSON message to those that are sent."""
        if len(self._texts) >= TEXTS_MAX:
            self.end()
            return
        self._texts.append(text)
        self._arrived.set()

    @property
    def keeps_up(self) -> bool:
        """Whether the page has read what it was sent, and so may get messages that it can do
        without."""
        return not self._texts and self._open()

    def end(self) -> None:
        """End the connection of a page that does not read."""
        if (transport := self._connection.get_extra_info("transport")) is not None:
            transport.abort()

    async def run(self) -> None:
        """Serve the page until it is gone. Raises OSError in a group if its connection fails."""
        try:
            async with TaskGroup() as tasks:
                sending = tasks.create_task(self._send())
                async for message in self._connection:
                    match message.type:
                        case WSMsgType.BINARY:
                            self._take(message.data)
                        case WSMsgType.TEXT:
                            self._take_text(message.data, tasks)
                        case _:
                            break
                self._stand_up()
                sending.cancel()
        finally:
            self._stand_up()

    def _stand_up(self) -> None:
        """Release the pad and leave the procedure, at once, even if calls of the page are still
        being answered."""
        self._commissioning.leave(self)
        if self._seat is not None:
            self._seat.leave(self._driver)

    async def _send(self) -> None:
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            while self._texts:
                await self._connection.send_str(self._texts.popleft())
            if self._newest is not None and self._open():
                (number, frame), self._newest = self._newest, None
                self._sent.append((number, time.monotonic()))
                await self._connection.send_bytes(frame)

    def _open(self) -> bool:
        return not self._sent or time.monotonic() - self._sent[0][1] < WINDOW_S

    # ------------------------------------------------------------------------------------- asking
    def _take(self, raw: bytes) -> None:
        """Take a frame of the page."""
        with contextlib.suppress(ValueError, NotTaken):  # reported to the page, and counted
            match raw[:1]:
                case b"":
                    pass
                case head if head[0] == ACKNOWLEDGE:
                    self._acknowledge(number_of(raw))
                case head if self._seat is None:
                    self._complain("this page may only watch: it has not shown the token")
                case head if head[0] == RELEASE:
                    self._seat.release(self._driver, number_of(raw))
                case head if head[0] == PRESENT:
                    sent_ms, seen_s = present_frame(raw)
                    waited_s = self._driver.delays.waited_s("page", round(sent_ms * 1e6))
                    self._commissioning.present(self, waited_s, seen_s)
                case head if head[0] == DRIVE:
                    self._drive(self._seat, raw)

    def _acknowledge(self, number: int) -> None:
        while self._sent and self._sent[0][0] <= number:
            self._sent.popleft()
        if self._newest is not None:
            self._arrived.set()

    def _drive(self, seat: Seat, raw: bytes) -> None:
        command = drive_frame(raw)
        if not self._commanding.take():
            self._complain(BUSY)
            return
        try:
            seat.drive(self._driver, command)
        except NotTaken as error:
            self._complain(str(error))

    def _complain(self, why: str) -> None:
        """Report to the page why a command was not passed on."""
        now_s = time.monotonic()
        if now_s - self._complained_s >= COMPLAIN_AGAIN_S:
            self._complained_s = now_s
            self._message({"not_driven": why})

    def _take_text(self, raw: str, tasks: TaskGroup) -> None:
        try:
            request = json_form.decode(raw)
        except ValueError:
            request = None
        if not isinstance(request, Mapping):
            self._message({"problem": "a message is a JSON object"})
        elif "rate_hz" in request:
            self._set_rate(request["rate_hz"])
        else:
            method = request.get("call")
            urgent = isinstance(method, str) and method in NEVER_TOO_MANY
            if not urgent and (self._calls >= CALLS_MAX or not self._asking.take()):
                self._answer(request, {"error": BUSY})
                return
            self._calls += 1
            tasks.create_task(self._call(request, method))

    def _set_rate(self, rate_hz: object) -> None:
        if isinstance(rate_hz, int | float) and rate_hz >= RATE_MIN_HZ:
            self.rate_hz = float(min(rate_hz, self._rate_max_hz))

    async def _call(self, request: Mapping[str, Any], method: object) -> None:
        params = request.get("params", {})
        try:
            if not isinstance(method, str) or not isinstance(params, Mapping):
                raise NotTaken(f"a call has a name and parameters, not {short(method)}")
            self._answer(request, {"result": await self._serve(self, method, params)})
        except (NotTaken, ClientError) as error:
            force = getattr(error, "code", None) == NEEDS_FORCE
            self._answer(request, {"error": str(error)} | ({"needs_force": True} if force else {}))
        except OSError as error:  # out of descriptors, perhaps: no reason to cut the page off
            _log.warning("%s: %s failed: %s", self.name, method, error)
            self._answer(request, {"error": f"the robot's computer: {error.strerror or error}"})
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            # a parameter that its method did not check: a bug, which costs this message alone
            _unchecked.say(f"{self.name}: {short(method)}: {type(error).__name__}: {error}")
            self._answer(request, {"error": f"a parameter of {short(method)} cannot be used"})
        finally:
            self._calls -= 1

    def _answer(self, request: Mapping[str, Any], answer: dict[str, Any]) -> None:
        self._message({"answer": tag(request.get("id"))} | answer)

    def _message(self, message: dict[str, Any]) -> None:
        self.say(json.dumps(json_form.plain(message), allow_nan=False))
