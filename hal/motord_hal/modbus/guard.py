# SPDX-License-Identifier: Apache-2.0
"""Guard around pymodbus that checks every byte.

pymodbus 3.16 hands a late reply to the next request, accepts short replies, wrong functions and
wrong echoes, loses a good reply behind a glitch byte and keeps no silent interval. Therefore:

- the framer knows the one request in flight; only a frame that `codec.parse_reply` accepts as the
  answer to exactly this request passes, at any place in the bytes;
- nothing is sent before the line was silent for the gap of the standard, counted from the last
  byte seen in either direction (MODBUS over Serial Line V1.02, 2.5.1.1);
- a unit that failed to answer gets no request for one more reply time, so that its late reply falls
  into the silence and not into the next request;
- a broadcast is followed by the turn-around delay of the standard (2.4.1).

RTU cannot distinguish an even later answer from the answer to the next equal request."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerBase, FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU

from motord_hal.base.clock import now_s, sleep_until_s, within
from motord_hal.base.errors import BadReply, NoReply, PortError, Refused
from motord_hal.fieldbus.ports import Echo
from motord_hal.fieldbus.trace import PythonTrace
from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    EXCEPTION_BYTES,
    EXCEPTION_TEXT,
    FrameError,
    Function,
    Reply,
    Request,
    build_request,
    character_bits,
    frame_time_s,
    parse_reply,
    reply_bytes,
    silent_interval_s,
)
from motord_hal.modbus.late import LateReplies
from motord_hal.modbus.timing import LATE_UART_S, late_silence_s
from motord_hal.serial.counters import Traffic, Witness
from motord_hal.serial.sysfs import device_file

if TYPE_CHECKING:
    from motord_hal.serial.loop_port import LoopPort

BROADCAST_TURNAROUND_S = 0.1
"""Turn-around delay, Serial Line V1.02, 2.4.1: 100 to 200 ms, typically."""
NEVER_SILENT_S = 0.25
"""Time after which a line on which bytes keep coming without a request has another master or a
broken transceiver."""
URGENT_NOISE_S = 0.02
URGENT_UNIT_S = 0.05
"""Time that an urgent request waits beyond its gap on a line that is never silent, or for a unit
that may still answer late. Then it goes out anyway: a stop that may collide is better than one that
is never sent."""

# A failed try is not logged: the line reports once when a drive stops answering.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


@contextlib.contextmanager
def keeping_cancellation() -> Iterator[None]:
    """Raise CancelledError if a cancellation came in the block. pymodbus turns one into its own
    exception, and asyncio.wait_for, which it uses, drops one that meets the result (before Python
    3.12)."""
    task = asyncio.current_task()
    cancels = task.cancelling() if task else 0
    try:
        yield
    finally:
        if task and task.cancelling() > cancels:
            raise asyncio.CancelledError


class Strict(FramerBase):
    """Framer that passes only the answer to the current request. All media share this part."""

    def __init__(self) -> None:
        super().__init__(DecodePDU(is_server=False))
        self._request: Request | None = None
        self.reply: Reply | None = None
        self.accepted_s = 0.0
        self.refused = ""
        """Why the received bytes are no answer; "": no bytes came."""
        self._kept = b""
        """Bytes left for the next call. pymodbus passes them again, with the newer ones."""

    def arm(self, request: Request) -> None:
        self._request, self.reply, self.refused = request, None, ""
        self._kept = b""  # pymodbus drops it when it sends

    def unseen(self, data: bytes) -> bytes:
        """Return the new bytes among those for the next call of handleFrame."""
        return data.removeprefix(self._kept)

    def disarm(self) -> None:
        self._request = None

    def _accept(self, request: Request, frame: bytes) -> ModbusPDU | None:
        """Return the answer for pymodbus; None: no answer, and `refused` is the reason."""
        try:
            self.reply = parse_reply(request, frame)
        except FrameError as error:
            self.refused = str(error)
            return None
        self.accepted_s = now_s()
        pdu = self.decoder.decode(frame[1:-2])
        if pdu is not None:
            pdu.dev_id = request.unit
        return pdu


class StrictFramer(Strict, FramerRTU):
    """Framer for RTU frames at any place in the bytes.

    An adapter with echo returns each request before its reply; for function 6 both are equal. The
    robot file states whether there is an echo, or the newest read shows it. If there is, the first
    copy of a write is not an acknowledgement.
    """

    def __init__(self, echo: Echo = Echo.AUTO) -> None:
        super().__init__()
        self._learns = echo is Echo.AUTO
        self._echoes = echo is Echo.YES

    def handleFrame(  # noqa: N802  # pymodbus's name
        self, data: bytes, exp_devid: int, exp_tid: int
    ) -> tuple[int, ModbusPDU | None]:
        """Judge all bytes not used yet. pymodbus calls this. Return the number of used bytes."""
        del exp_devid, exp_tid  # the current request has all that is needed
        used, pdu = self._judge(data)
        self._kept = data[used:]
        return used, pdu

    def _judge(self, data: bytes) -> tuple[int, ModbusPDU | None]:
        request = self._request
        if request is None or request.unit == BROADCAST_UNIT:
            return len(data), None
        due, copy = reply_bytes(request), build_request(request)
        alike = request.function is Function.WRITE_SINGLE
        first = 0
        if alike and self._echoes:
            place = data.find(copy)
            first = place + len(copy) if place >= 0 else len(data)
        for begin in range(first, len(data)):
            for size in {due, EXCEPTION_BYTES}:
                frame = data[begin : begin + size]
                if len(frame) == size and (pdu := self._accept(request, frame)) is not None:
                    if self._learns and not alike:
                        self._echoes = data[:begin].endswith(copy)
                    self.disarm()
                    return len(data), pdu
        # All but a tail that may still become the answer is garbage.
        self.refused = self.refused or f"{data.hex(' ')} is no answer"
        return max(0, len(data) - max(due, EXCEPTION_BYTES) - len(copy) + 1), None


@dataclass(frozen=True, slots=True)
class Answer:
    """A reply. `stamp_ns` is the middle of the exchange, `round_trip_s` its duration."""

    values: tuple[int, ...]
    stamp_ns: int
    round_trip_s: float


class GuardedClient:
    """One serial port, with one request in flight."""

    kind = "modbus-rtu"

    def __init__(
        self,
        port: str,
        baudrate: int,
        parity: str,
        stop_bits: int,
        gap_s: float | None,
        echo: Echo = Echo.AUTO,
    ) -> None:
        self.port = port
        self._serial = (baudrate, parity, stop_bits)
        bits = character_bits(parity, stop_bits)
        self.gap_s = silent_interval_s(baudrate, bits) if gap_s is None else gap_s
        self._client: AsyncModbusSerialClient | AsyncModbusTcpClient | None = None
        self._port: LoopPort | None = None
        self._lost = "went away"
        self._framer: Strict = StrictFramer(echo)
        self._lock = asyncio.Lock()
        self._last_byte_s = 0.0
        self._sent_s = 0.0
        self._line_silent_until_s = 0.0
        self._unit_silent_until_s: dict[int, float] = {}
        self.trace = PythonTrace()
        self._witness = Witness()
        self._late = LateReplies()
        self._received_bytes = 0
        self._frames = 0
        self._noise_bytes = 0
        """Bytes received since the request, answers since opening, bytes of noise since opening."""

    def wire_time_s(self, size_bytes: int) -> float:
        return frame_time_s(size_bytes, *self._serial)

    def reply_deadline_s(self, request: Request, turnaround_s: float) -> float:
        """Return the deadline from the request's last byte on: turn-around, reply on the wire,
        allowance."""
        return turnaround_s + self.wire_time_s(reply_bytes(request)) + LATE_UART_S

    @property
    def connected(self) -> bool:
        usable = self._port is None or self._port.is_usable
        return usable and self._client is not None and self._client.connected

    async def open(self) -> None:
        """Open the port exclusively. Raises PortError."""
        # imported only here: only lines with a port need these libraries
        from motord_hal.serial.loop_port import LoopPort

        self.close()
        client = AsyncModbusSerialClient(
            self.port,
            timeout=10.0,  # never reached: every request has its own deadline, far below
            retries=0,
            reconnect_delay=0,
            trace_packet=self._trace_packet,
        )
        client.ctx.framer = self._framer
        protocol = cast("asyncio.Protocol", client.ctx)  # it has the methods of a protocol
        self._port = LoopPort(device_file(self.port), *self._serial, protocol)
        # the transport reports this itself, but only in the next turn of the event loop
        protocol.connection_made(self._port.transport)
        self._client, self._lost = client, "went away"
        self._witness.forget()
        self._late.forget()
        self._noise_bytes = 0
        self._last_byte_s = now_s()
        self._unit_silent_until_s.clear()

    def close(self) -> None:
        """Close the port; does nothing if it is not open."""
        if self._port is not None:
            self._port.let_go()
            self._port = None
        if self._client is not None:
            self._client.close()
            self._client = None

    def _trace_packet(self, sending: bool, data: bytes) -> bytes:
        self._last_byte_s = now_s()
        unseen = data if sending else self._framer.unseen(data)
        if self.trace.on:
            self.trace.put(round(self._last_byte_s * 1e9), unseen, outward=sending)
        if sending:
            self._late.sent()
            self._received_bytes = 0
            self._sent_s = self._last_byte_s
            self._last_byte_s += self.wire_time_s(len(data))
        else:
            self._late.came(unseen)
            self._received_bytes += len(unseen)
        return data

    async def exchange(
        self,
        request: Request,
        within_s: float,
        send_by_s: float = math.inf,
        *,
        urgent: bool = False,
    ) -> Answer:
        """Send the request and return its answer, due `within_s` after the request's last byte.
        After `send_by_s` it is not sent: NoReply. An urgent request stops a drive: noise delays it
        only briefly.

        Raises NoReply, BadReply, Refused, PortError. A broadcast returns at once, without values.
        """
        async with self._lock:
            await self._wait_for_silence(request.unit, urgent=urgent)
            if now_s() > send_by_s:
                raise NoReply(f"{self.port} unit {request.unit}: too old to be sent")
            self._framer.arm(request)
            answered = False
            try:
                await self._transmit(request, within_s)
                answered = self._framer.reply is not None
                self._frames += answered
            finally:
                self._framer.disarm()
                if answered:
                    self._late.answered(request)
                else:
                    self._leave_alone(request, within_s)
            return self._answer(request)

    async def _transmit(self, request: Request, within_s: float) -> None:
        """Make pymodbus send and receive. The result is in the framer, so pymodbus's own is not
        needed."""
        limit_s = self.wire_time_s(len(build_request(request))) + within_s
        self._sent_s = now_s()
        with (
            keeping_cancellation(),
            contextlib.suppress(TimeoutError, ModbusException),
        ):
            async with within(limit_s):
                await self._send(request)

    async def _send(self, request: Request) -> None:
        client = self._client
        if client is None or not client.connected:
            raise PortError(f"{self.port} is not open")
        alone = request.unit == BROADCAST_UNIT
        match request.function:
            case Function.READ_HOLDING:
                await client.read_holding_registers(
                    request.address, count=request.count, device_id=request.unit
                )
            case Function.WRITE_SINGLE:
                await client.write_register(
                    request.address,
                    request.values[0],
                    device_id=request.unit,
                    no_response_expected=alone,
                )
            case Function.WRITE_MULTIPLE:
                await client.write_registers(
                    request.address,
                    list(request.values),
                    device_id=request.unit,
                    no_response_expected=alone,
                )
            case Function.READ_WRITE:
                await client.readwrite_registers(
                    read_address=request.address,
                    read_count=request.count,
                    write_address=request.write_address,
                    values=list(request.values),
                    device_id=request.unit,
                )
            case _:
                raise ValueError(f"{request.function.name} is not a request of any drive profile")

    def _answer(self, request: Request) -> Answer:
        reply = self._framer.reply
        end_s = self._framer.accepted_s if reply else now_s()
        round_trip_s = end_s - self._sent_s
        stamp_ns = round((self._sent_s + end_s) * 0.5e9)
        what = f"{self.port} unit {request.unit}, {request.function.name} {request.address:#06x}"
        if request.unit == BROADCAST_UNIT:
            return Answer((), stamp_ns, round_trip_s)
        if reply is None:
            if not self.connected:
                raise PortError(f"{self.port} {self._lost}")
            if self._framer.refused:
                raise BadReply(f"{what}: {self._framer.refused}")
            raise NoReply(f"{what}: nothing within {round_trip_s * 1e3:.1f} ms")
        if reply.exception is not None:
            text = EXCEPTION_TEXT.get(reply.exception, "unknown exception")
            raise Refused(f"{what}: {text} (exception {reply.exception})", reply.exception)
        return Answer(reply.values, stamp_ns, round_trip_s)

    def _leave_alone(self, request: Request, within_s: float) -> None:
        """Send this unit no request for one more reply time, after a failure or a cancellation.
        After a broadcast, nothing is sent for BROADCAST_TURNAROUND_S."""
        if self._port is not None and self._port.is_stuck:
            self.close()  # a set-point must not go out later and move a motor
            self._lost = "takes no bytes"
        self._late.failed(request)
        self._noise_bytes += self._received_bytes
        now = now_s()
        sent = self._sent_s + self.wire_time_s(len(build_request(request)))
        if request.unit == BROADCAST_UNIT:
            self._line_silent_until_s = max(now, sent) + BROADCAST_TURNAROUND_S
        else:
            silence_s = late_silence_s(self.kind, within_s)
            self._unit_silent_until_s[request.unit] = max(now, sent + within_s) + silence_s

    async def _wait_for_silence(self, unit: int, *, urgent: bool) -> None:
        """Wait until the line was silent for the gap and no late reply is expected. Raises BadReply
        if it is never silent, unless the request is urgent: that is sent then."""
        asked_s = self._unit_silent_until_s.get(unit, 0.0)
        patience_s = NEVER_SILENT_S
        if urgent:
            asked_s = min(asked_s, now_s() + URGENT_UNIT_S)
            patience_s = self.gap_s + URGENT_NOISE_S
        silent_until_s = max(self._line_silent_until_s, asked_s)
        give_up_s = max(now_s(), silent_until_s) + patience_s
        while True:
            self._drain()
            free_s = max(self._last_byte_s + self.gap_s, silent_until_s)
            now = now_s()
            if now >= free_s:
                return
            if now > give_up_s:
                if urgent:
                    return
                raise BadReply(f"{self.port} is never silent: another master, or noise")
            await sleep_until_s(min(free_s, max(give_up_s, now)))

    @property
    def _traffic(self) -> Traffic:
        return Traffic(noise_bytes=self._noise_bytes, frames=self._frames, late=self._late.count)

    def unresponsive_hint(self) -> str:
        """Return a hint on an unresponsive drive from the UART driver's counters; "": no hint."""
        if self._port is None or not self.connected:
            return ""
        return self._witness.hint(self._port.fileno(), self._traffic)

    def _drain(self) -> None:
        """Drop bytes that were not requested, and note their time. Raises PortError."""
        if self._port is None or not self.connected:
            raise PortError(f"{self.port} is not open")
        self._witness.look(self._port.fileno(), self._traffic)
        try:
            if drained := self._port.drain():
                self._last_byte_s = now_s()
                self.trace.put(round(self._last_byte_s * 1e9), drained, outward=False)
                self._late.came(drained)
            self._late.look()
        except PortError:
            self.close()
            raise
