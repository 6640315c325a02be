# SPDX-License-Identifier: Apache-2.0
"""A RoboClaw's port: one packet in flight, and an answer only when every byte of it is right.

An answer does not say what it answers, so a late one would be taken for the next: after a failure
the port is left alone for one more reply time, and what came meanwhile is thrown away.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace

from motord_hal.base.clock import now_s, sleep_until_s, within
from motord_hal.base.errors import BadReply, NoReply, PortError
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.mcu.link import Stream
from motord_hal.modbus.codec import Request
from motord_hal.modbus.guard import (
    SCHEDULING_ALLOWANCE_S,
    URGENT_UNIT_S,
    Answer,
    GuardedClient,
)
from motord_hal.roboclaw import codec


class RoboclawClient(GuardedClient):
    """As GuardedClient, on packets. All other commands than those of the codec are refused before
    anything is sent."""

    def __init__(self, spec: LineSpec, gap_s: float, holds: Callable[[int], bool]) -> None:
        super().__init__(spec.port, spec.baudrate, spec.parity, spec.stop_bits, gap_s)
        self._holds = holds
        self._stream = Stream(spec, self._take_in)
        self._came = bytearray()
        self._news = asyncio.Event()
        self._alone_until_s = 0.0

    @property
    def connected(self) -> bool:
        return self._stream.is_open

    async def open(self) -> None:
        """Open the port for ourselves alone. Raises PortError."""
        self._stream.open()
        self._alone_until_s = 0.0

    def close(self) -> None:
        """Let the port go; nothing happens when it is not open."""
        self._stream.close()
        self._news.set()

    def _take_in(self, data: bytes) -> None:
        self._came += data
        self._news.set()

    def reply_deadline_s(self, request: Request, turnaround_s: float) -> float:
        """As GuardedClient's."""
        size = codec.reply_size(request)
        return turnaround_s + self.wire_time_s(size) + SCHEDULING_ALLOWANCE_S

    async def exchange(
        self,
        request: Request,
        within_s: float,
        send_by_s: float = math.inf,
        *,
        urgent: bool = False,
    ) -> Answer:
        """As GuardedClient.exchange."""
        async with self._lock:
            alone_for_s = URGENT_UNIT_S if urgent else math.inf
            await sleep_until_s(min(self._alone_until_s, now_s() + alone_for_s))
            if now_s() > send_by_s:
                raise NoReply(f"{self._what(request)}: too old to be sent")
            request = self._at_rest(request)
            packet = codec.build(request)
            self._came.clear()
            sent_s = now_s()
            limit_s = self.wire_time_s(len(packet)) + within_s
            # also when this task is cancelled: what comes then is nobody's answer
            self._alone_until_s = sent_s + limit_s + within_s
            if not self._stream.send(packet):
                raise NoReply(f"{self._what(request)}: the port takes no bytes")
            await self._receive(request, limit_s)
            answer = self._answer_of(request, sent_s)
            self._alone_until_s = 0.0
            return answer

    def _at_rest(self, request: Request) -> Request:
        """Duties of zero for speeds of zero, where nothing is to be held."""
        idle = request.address >> 8 == codec.SPEEDS and not any(request.values)
        if request.values and idle and not self._holds(request.unit):
            return replace(request, address=codec.DUTIES << 8, values=(0, 0))
        return request

    async def _receive(self, request: Request, limit_s: float) -> None:
        """Until all bytes are there, or the time is over. Raises PortError."""
        size = codec.reply_size(request)
        try:
            async with within(limit_s):
                while len(self._came) < size:
                    if not self.connected:
                        raise PortError(f"{self.port} went away")
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            return

    def _answer_of(self, request: Request, sent_s: float) -> Answer:
        end_s = now_s()
        if not self._came:
            waited_s = end_s - sent_s
            raise NoReply(f"{self._what(request)}: nothing within {waited_s * 1e3:.1f} ms")
        try:
            values = codec.parse(request, bytes(self._came))
        except codec.PacketError as error:
            raise BadReply(f"{self._what(request)}: {error}") from error
        return Answer(values, round((sent_s + end_s) * 0.5e9), end_s - sent_s)

    def _what(self, request: Request) -> str:
        return f"{self.port} address {request.unit:#x}, command {request.address >> 8}"
