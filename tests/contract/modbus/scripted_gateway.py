# SPDX-License-Identifier: Apache-2.0
"""The scripted slave behind a TCP socket: as a Modbus TCP gateway, or as a serial server that
passes RTU frames."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import time
from pathlib import Path

from scripted_slave import ScriptedSlave

from motord_hal.modbus.codec import parse_request, request_bytes, seal

GATEWAYS = ["modbus-tcp", "rtu-over-tcp"]


def peer_on(medium: str, folder: Path) -> ScriptedSlave:
    """Return a slave behind a gateway if `medium` is a kind of gateway, else on a pty."""
    if medium in GATEWAYS:
        return ScriptedGateway(medium)
    return ScriptedSlave(folder / "port", engine=medium)


class ScriptedGateway(ScriptedSlave):
    """A slave whose `path` is HOST:PORT; that stays the same after it is pulled and plugged in."""

    def __init__(self, kind: str) -> None:
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._port = 0
        self.connections = 0
        self.transaction = 0
        """Transaction number of the newest request; replies carry it."""
        super().__init__(Path())
        self.kind = kind

    def plug(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", self._port))
        self._listener.settimeout(0)
        self._port = self._listener.getsockname()[1]
        self.path = Path(f"127.0.0.1:{self._port}")
        asyncio.get_running_loop().add_reader(self._listener, self._connected)

    def pull(self) -> None:
        for timer in self._timers:
            timer.cancel()
        for end in (self._listener, self._client):
            if end is not None:
                asyncio.get_running_loop().remove_reader(end)
                end.close()
        self._listener = self._client = None
        self._buffer = b""

    def send(self, data: bytes) -> None:
        """Send an RTU frame in the form of the medium."""
        self.answered_at_s.append(time.monotonic())
        if self.kind == "modbus-tcp" and data:
            body = data[:-2]
            data = struct.pack(">HHH", self.transaction, 0, len(body)) + body
        self.send_raw(data)

    def send_raw(self, data: bytes) -> None:
        if self._client is not None:
            with contextlib.suppress(ConnectionError):
                self._client.send(data)

    def _connected(self) -> None:
        assert self._listener is not None
        if self._client is not None:
            asyncio.get_running_loop().remove_reader(self._client)
            self._client.close()
        self._client, _ = self._listener.accept()
        self._client.settimeout(0)
        self._buffer = b""
        self.connections += 1
        asyncio.get_running_loop().add_reader(self._client, self._readable)

    def _readable(self) -> None:
        assert self._client is not None
        data = b""
        with contextlib.suppress(ConnectionError):
            data = self._client.recv(4096)
        if not data:
            asyncio.get_running_loop().remove_reader(self._client)
            self._client.close()
            self._client = None
            return
        self._buffer += data
        while (frame := self._frame()) is not None:
            self._serve(parse_request(frame))

    def _frame(self) -> bytes | None:
        """Take the next complete request as an RTU frame; None if there is no complete one."""
        if self.kind == "rtu-over-tcp":
            size = request_bytes(self._buffer)
            if size is None or len(self._buffer) < size:
                return None
            frame, self._buffer = self._buffer[:size], self._buffer[size:]
            return frame
        if len(self._buffer) < 6:
            return None
        self.transaction, protocol, length = struct.unpack_from(">HHH", self._buffer)
        assert protocol == 0
        if len(self._buffer) < 6 + length:
            return None
        body, self._buffer = self._buffer[6 : 6 + length], self._buffer[6 + length :]
        return seal(body)
