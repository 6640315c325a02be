# SPDX-License-Identifier: Apache-2.0
"""A Modbus TCP gateway in front of a simulated line. One request at a time goes on the wire behind
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
"""Reply time-out after the request's last byte on the wire; a usual setting of gateways."""
REST_TIMEOUT_S = 0.02
"""Time-out between the pieces of a reply."""
_HEADER_BYTES = 7
_LENGTH_MAX = 254
"""Greatest length of unit and PDU."""


@dataclass(slots=True, eq=False)
class _Request:
    client: Client
    transaction: int
    frame: bytes


class GatewayPort(TcpPort):
    """Port with any number of connections, served in the order of their requests."""

    def __init__(self, host: str, port: int, *, character_s: float, gap_s: float) -> None:
        super().__init__(host, port)
        self._character_s = character_s
        self._gap_s = gap_s
        self._rest()

    def _rest(self) -> None:
        self._requests: deque[_Request] = deque()
        self._in_progress: _Request | None = None
        self._reply = bytearray()
        self._deadline_s = math.inf
        self._overdue = False
        """Whether the deadline has passed. Bytes that were on the wire by then come with the next
        look."""
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
        waiting_s = self._free_s if self._requests and self._in_progress is None else math.inf
        waiting_s = now_s if self._just_over else waiting_s
        return min(super().due_s(now_s), self._deadline_s, waiting_s)

    def take_in(self, now_s: float) -> bytes | None:
        """Return the next request's frame, once the previous one has ended."""
        if now_s >= self._stalled_until_s:
            self._flush(now_s)
            self._accept()
            for client in list(self._clients):
                self._read(client, now_s)
        if self._just_over:  # the last byte has passed only now
            self._just_over = False
            self._free_s = now_s + self._gap_s
        if self._in_progress is not None and self._overdue:
            self._fail(self._in_progress, now_s)
        self._overdue = now_s >= self._deadline_s
        if self._in_progress is not None or not self._requests or now_s < self._free_s:
            return b""
        return self._begin(self._requests.popleft(), now_s)

    def put(self, data: bytes, now_s: float) -> int:
        """Take bytes from the wire. Bytes that were not requested are dropped."""
        if self._in_progress is None:
            return len(data)
        self._reply += data
        self._deadline_s = max(self._deadline_s, now_s + REST_TIMEOUT_S)
        self._overdue = False
        if _complete(bytes(self._reply)):
            answered = self._reply[0] == self._in_progress.frame[0]
            body = bytes(self._reply[:-2])
            self._reply.clear()
            if answered:
                self._finish(self._in_progress, body, now_s)
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
            self._requests.append(_Request(client, transaction, frame))
            for held in client.held:
                self._transmit(client, held, now_s)
            client.held.clear()

    def _begin(self, request: _Request, now_s: float) -> bytes:
        self._reply.clear()
        on_wire_s = len(request.frame) * self._character_s
        if request.frame[0] == BROADCAST_UNIT:
            self._free_s = now_s + on_wire_s + self._gap_s
        else:
            self._in_progress = request
            self._deadline_s = now_s + on_wire_s + REPLY_TIMEOUT_S
        return request.frame

    def _fail(self, request: _Request, now_s: float) -> None:
        refusal = bytes((request.frame[0], request.frame[1] | EXCEPTION_FLAG, TARGET_SILENT))
        self._finish(request, refusal, now_s)

    def _finish(self, request: _Request, body: bytes, now_s: float) -> None:
        unit_and_pdu = struct.pack(">HHH", request.transaction, 0, len(body)) + body
        if self._hold:
            request.client.held.append(unit_and_pdu)
        else:
            self._transmit(request.client, unit_and_pdu, now_s)
        self._hold = False
        self._in_progress = None
        self._overdue = False
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
