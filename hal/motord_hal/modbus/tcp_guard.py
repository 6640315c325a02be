# SPDX-License-Identifier: Apache-2.0
"""The guard of guard.py for drives behind a gateway in the network: Modbus TCP, or RTU frames
through a serial server.

TCP differs in two points: a reply has the number of its transaction, so a late one differs from the
next (MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3). And the network may deliver a
request much later: a request that is stuck is dropped with its connection, so that no old set-point
ever reaches a drive.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import math
import socket
import struct
import sys
import termios
from typing import cast

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.framer import FramerSocket
from pymodbus.pdu import ModbusPDU

from motord_hal.base.clock import now_s, sleep_until_s, within
from motord_hal.base.errors import NoReply, PortError, Refused
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.codec import BROADCAST_UNIT, Request, seal
from motord_hal.modbus.guard import (
    Answer,
    GuardedClient,
    Strict,
    StrictFramer,
    keeping_cancellation,
)
from motord_hal.modbus.timing import LATE_NETWORK_S, line_gap_s

CONNECT_WITHIN_S = 2.0
DELIVERED_WITHIN_S = 0.5
"""Time limit for a gateway's acknowledgement; many send it only after 0.2 s."""
LOOK_EVERY_S = 0.002
SILENT_S = 5.0
"""Time of silence after which the gateway may have lost the connection, and a new one is opened."""
_HEADER_BYTES = 7
_LENGTH_MAX = 254
"""Greatest length of unit and PDU: Implementation Guide V1.0b, 3.1.3, and Application Protocol
V1.1b3, 4.1."""
_UNREAD_MAX = 4096
"""Limit for unread bytes. A gateway has one request at a time to answer: room for that answer and
some late ones."""
_SHOWN_BYTES = 16
_GATEWAY_EXCEPTIONS = (10, 11)
"""Exceptions by which the gateway reports that it does not reach the drive: V1.1b3, 7."""


class StrictTcpFramer(Strict, FramerSocket):
    """Framer for frames with the MBAP header. Frames of other transactions are skipped."""

    def __init__(self) -> None:
        super().__init__()
        self._buffer = b""
        self.lost = ""
        """Why frames cannot be found any more: the bytes are not Modbus TCP; "": they can."""

    def handleFrame(  # noqa: N802  # pymodbus's name
        self, data: bytes, exp_devid: int, exp_tid: int
    ) -> tuple[int, ModbusPDU | None]:
        """Judge all bytes not used yet. pymodbus calls this. Return the number of used bytes."""
        del exp_devid  # the current request has it
        if len(data) > _UNREAD_MAX:
            self._lose(f"{len(data)} bytes at once are no Modbus TCP")
        if self.lost:
            return len(data), None
        # pymodbus drops the first half of a late reply when it sends: kept here, so that the other
        # half is not read as the beginning of a frame
        self._buffer += data
        found = None
        while found is None and len(self._buffer) >= _HEADER_BYTES:
            transaction, protocol, length = struct.unpack_from(">HHH", self._buffer)
            if protocol or not 2 <= length <= _LENGTH_MAX:
                self._lose(f"{self._buffer[:_SHOWN_BYTES].hex(' ')} is no Modbus TCP")
                break
            if len(self._buffer) < 6 + length:
                break
            body, self._buffer = self._buffer[6 : 6 + length], self._buffer[6 + length :]
            found = self._judge(transaction == exp_tid, body)
            if found is not None:
                found.transaction_id = transaction
        return len(data), found

    def _lose(self, why: str) -> None:
        self.lost = self.refused = why
        self._buffer = b""

    def _judge(self, expected: bool, body: bytes) -> ModbusPDU | None:
        request = self._request
        if request is None or not expected or request.unit == BROADCAST_UNIT:
            return None
        pdu = self._accept(request, seal(body))
        self.disarm()  # only one answer belongs to a transaction
        return pdu


class GatewayClient(GuardedClient):
    """One connection to a gateway, with one request in flight. Baud rate and the like are those of
    the wire behind it."""

    def __init__(self, spec: LineSpec) -> None:
        super().__init__(spec.port, spec.baudrate, spec.parity, spec.stop_bits, line_gap_s(spec))
        self.kind = spec.kind
        self._raw = spec.kind == "rtu-over-tcp"
        self._echo = spec.echo
        self._framer = StrictFramer(spec.echo) if self._raw else StrictTcpFramer()
        self._silent_since_s = math.inf

    def reply_deadline_s(self, request: Request, turnaround_s: float) -> float:
        """Return `GuardedClient`'s deadline plus the network's part."""
        base_s = super().reply_deadline_s(request, turnaround_s)
        return base_s + 2 * self.gap_s + LATE_NETWORK_S

    async def open(self) -> None:
        """Connect. Raises PortError."""
        self.close()
        host, _, port = self.port.rpartition(":")
        framer = StrictFramer(self._echo) if self._raw else StrictTcpFramer()
        client = AsyncModbusTcpClient(
            host,
            port=int(port),
            timeout=10.0,  # never met: every request has a deadline of its own, far below
            retries=0,
            reconnect_delay=0,
            trace_packet=self._trace_packet,
        )
        client.ctx.framer = framer
        # pymodbus silently drops anything longer than a frame; the framer judges it
        client.ctx.max_buffer_size = sys.maxsize
        with contextlib.ExitStack() as undo:
            undo.callback(client.close)
            try:
                with keeping_cancellation():
                    async with within(CONNECT_WITHIN_S):
                        connected = await client.connect()
            except TimeoutError:
                raise PortError(f"{self.port} did not accept in {CONNECT_WITHIN_S:g} s") from None
            if not connected:
                raise PortError(
                    f"{self.port} cannot be reached: no such host, no server listens, or it ends "
                    "the connection at once"
                )
            _set_options(client.ctx.transport, self.port)
            undo.pop_all()
        self._client, self._framer = client, framer
        self._silent_since_s = math.inf
        self._last_byte_s = now_s()
        self._unit_silent_until_s.clear()

    def _transport(self) -> asyncio.WriteTransport | None:
        transport = self._client.ctx.transport if self._client else None
        return cast("asyncio.WriteTransport | None", transport)

    def _socket(self) -> socket.socket | None:
        transport = self._transport()
        return transport.get_extra_info("socket") if transport else None

    def _undelivered(self) -> bool:
        """Whether bytes of a request still wait on this computer."""
        transport, link = self._transport(), self._socket()
        if transport is None or link is None or link.fileno() < 0:
            return False
        unacknowledged = fcntl.ioctl(link.fileno(), termios.TIOCOUTQ, bytes(4))
        return bool(transport.get_write_buffer_size() or any(unacknowledged))

    def close(self) -> None:
        """Close as `GuardedClient.close` does; bytes that were not sent are dropped."""
        if (transport := self._transport()) is not None:
            transport.abort()
        super().close()

    def _trace_packet(self, sending: bool, data: bytes) -> bytes:
        data = super()._trace_packet(sending, data)
        if not self._raw:
            self._last_byte_s = 0.0  # the gateway keeps the silence of the wire behind it
        return data

    async def _wait_for_silence(self, unit: int, *, urgent: bool) -> None:
        """Wait until the previous request has arrived, and for silence. Raises PortError if it has
        not. An urgent request then opens a new connection instead."""
        if now_s() - self._silent_since_s > SILENT_S:
            await self.open()
        try:
            await self._wait_for_delivery()
            await super()._wait_for_silence(unit, urgent=urgent)
        except PortError:
            if not urgent:
                raise
            await self.open()
            await super()._wait_for_silence(unit, urgent=urgent)

    async def _wait_for_delivery(self) -> None:
        give_up_s = now_s() + DELIVERED_WITHIN_S
        while self._undelivered():
            if now_s() > give_up_s:
                self.close()
                raise PortError(f"{self.port} takes no bytes any more")
            await sleep_until_s(now_s() + LOOK_EVERY_S)

    def _drain(self) -> None:
        """Check the connection. The framer drops bytes that were not requested. Raises
        PortError."""
        if isinstance(self._framer, StrictTcpFramer) and self._framer.lost:
            self.close()
            raise PortError(f"{self.port}: {self._framer.lost}")
        if not self.connected:
            raise PortError(f"{self.port} went away")

    def _answer(self, request: Request) -> Answer:
        """Return the answer as `GuardedClient` does. A drive that the gateway does not reach is
        NoReply."""
        silent_since_s, self._silent_since_s = self._silent_since_s, math.inf
        try:
            return super()._answer(request)
        except NoReply:
            self._silent_since_s = min(silent_since_s, now_s())
            raise
        except Refused as error:
            if error.code in _GATEWAY_EXCEPTIONS:
                raise NoReply(str(error)) from error
            raise


def _set_options(transport: asyncio.BaseTransport | None, port: str) -> None:
    """Make the socket send at once, and drop undelivered data when it closes (linger 0: a reset).
    Raises PortError: a gateway may reset a connection that it has just accepted, and asyncio then
    has closed the socket already."""
    link = None if transport is None else transport.get_extra_info("socket")
    if link is None:
        raise PortError(f"{port} ended the connection at once")
    try:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    except OSError as error:
        raise PortError(f"{port} ended the connection at once") from error
