# SPDX-License-Identifier: Apache-2.0
"""A Modbus TCP gateway in front of a simulated line: one request at a time goes on the wire behind
it, at the wire's pace.

Sources: MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3 (the MBAP header); MODBUS
Application Protocol V1.1b3, 7 (exception 0x0B: the target did not respond).
"""

from __future__ import annotations

import math
import struct
from collections import deque
from dataclasses import dataclass

from motord_hal.modbus.codec import BROADCAST_UNIT, EXCEPTION_FLAG, Function, seal, sealed
from motord_hal.sim.rs485.tcp import Client, TcpPort

TARGET_SILENT = 0x0B
REPLY_TIMEOUT_S = 0.2
"""After the request's last byte on the wire; what a gateway of the shelf can be set to."""
REST_TIMEOUT_S = 0.02
"""Between the pieces of a reply."""
_HEADER_BYTES = 7
_LENGTH_MAX = 254
"""Unit and PDU."""


@dataclass(slots=True, eq=False)
class _Ask:
    client: Client
    transaction: int
    frame: bytes


class GatewayPort(TcpPort):
    """Serves any number of connections, in the order of their requests."""

    def __init__(self, host: str, port: int, *, character_s: float, gap_s: float) -> None:
        super().__init__(host, port)
        self._character_s = character_s
        self._gap_s = gap_s
        self._rest()

    def _rest(self) -> None:
        self._asks: deque[_Ask] = deque()
        self._asking: _Ask | None = None
        self._reply = bytearray()
        self._deadline_s = math.inf
        self._free_s = -math.inf
        self._just_over = False
        self._hold = False

    def pull(self) -> None:
        super().pull()
        self._rest()

    def hold_reply(self) -> bool:
        self._hold = True
        return True

    def due_s(self, now_s: float) -> float:
        waiting_s = self._free_s if self._asks and self._asking is None else math.inf
        waiting_s = now_s if self._just_over else waiting_s
        return min(super().due_s(now_s), self._deadline_s, waiting_s)

    def take_in(self, now_s: float) -> bytes | None:
        """The next request's frame, once the one before is through."""
        if now_s >= self._stalled_until_s:
            self._flush(now_s)
            self._accept()
            for client in list(self._clients):
                self._read(client, now_s)
        if self._just_over:  # only now is the last byte surely over
            self._just_over = False
            self._free_s = now_s + self._gap_s
        if self._asking is not None and now_s >= self._deadline_s:
            self._fail(self._asking, now_s)
        if self._asking is not None or not self._asks or now_s < self._free_s:
            return b""
        return self._begin(self._asks.popleft(), now_s)

    def put(self, data: bytes, now_s: float) -> int:
        """Bytes of the wire; those that nobody has asked for are dropped."""
        if self._asking is None:
            return len(data)
        self._reply += data
        self._deadline_s = max(self._deadline_s, now_s + REST_TIMEOUT_S)
        if _complete(bytes(self._reply)):
            answered = self._reply[0] == self._asking.frame[0]
            body = bytes(self._reply[:-2])
            self._reply.clear()
            if answered:
                self._finish(self._asking, body, now_s)
        return len(data)

    # --------------------------------------------------------------------------------- in detail
    def _read(self, client: Client, now_s: float) -> None:
        client.buffer += self._receive(client)
        while len(client.buffer) >= _HEADER_BYTES:
            transaction, protocol, length = struct.unpack_from(">HHH", client.buffer)
            if protocol or not 2 <= length <= _LENGTH_MAX:
                self._drop(client)
                return
            if len(client.buffer) < 6 + length:
                return
            frame = seal(bytes(client.buffer[6 : 6 + length]))
            del client.buffer[: 6 + length]
            self._asks.append(_Ask(client, transaction, frame))
            for held in client.held:
                self._transmit(client, held, now_s)
            client.held.clear()

    def _begin(self, ask: _Ask, now_s: float) -> bytes:
        self._reply.clear()
        on_wire_s = len(ask.frame) * self._character_s
        if ask.frame[0] == BROADCAST_UNIT:
            self._free_s = now_s + on_wire_s + self._gap_s
        else:
            self._asking = ask
            self._deadline_s = now_s + on_wire_s + REPLY_TIMEOUT_S
        return ask.frame

    def _fail(self, ask: _Ask, now_s: float) -> None:
        refusal = bytes((ask.frame[0], ask.frame[1] | EXCEPTION_FLAG, TARGET_SILENT))
        self._finish(ask, refusal, now_s)

    def _finish(self, ask: _Ask, body: bytes, now_s: float) -> None:
        unit_and_pdu = struct.pack(">HHH", ask.transaction, 0, len(body)) + body
        if self._hold:
            ask.client.held.append(unit_and_pdu)
        else:
            self._transmit(ask.client, unit_and_pdu, now_s)
        self._hold = False
        self._asking = None
        self._deadline_s = math.inf
        self._free_s = math.inf
        self._just_over = True


def _complete(frame: bytes) -> bool:
    """Whether a reply is whole and good."""
    if not sealed(frame):
        return False
    if frame[1] & EXCEPTION_FLAG:
        return len(frame) == 5
    if frame[1] in (Function.READ_HOLDING, Function.READ_INPUT, Function.READ_WRITE):
        return len(frame) == 5 + frame[2]
    return len(frame) == 8 if frame[1] in tuple(Function) else True
