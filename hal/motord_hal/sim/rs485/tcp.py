# SPDX-License-Identifier: Apache-2.0
"""Ports of a line behind a TCP socket: the connections, and raw Modbus RTU through them, as serial
servers pass it."""

from __future__ import annotations

import contextlib
import math
import socket
from collections import deque
from dataclasses import dataclass, field

from motord_hal.sim.rs485.port import MasterSettings

RECEIVE_BYTES = 4096
PIECES = 3
"""Number of segments of a reply that comes in pieces."""


@dataclass(slots=True, eq=False)
class Client:
    socket: socket.socket
    buffer: bytearray = field(default_factory=bytearray)
    held: list[bytes] = field(default_factory=list)


class TcpPort:
    """A listening socket and its connections. Subclasses define what they carry."""

    def __init__(self, host: str, port: int) -> None:
        """Set the port up. Port 0: any free one, which stays the same when the plug is pulled and
        put in."""
        self.segments_s = 0.0
        self._host, self._port = host, port
        self._listener: socket.socket | None = None
        self._clients: list[Client] = []
        self._forgotten: list[Client] = []
        self._outgoing: deque[tuple[float, Client, bytes]] = deque()
        self._stalled_until_s = -math.inf

    @property
    def address(self) -> str:
        return f"{self._host}:{self._port}"

    @property
    def plugged(self) -> bool:
        return self._listener is not None

    def plug(self) -> None:
        try:
            listener = socket.create_server((self._host, self._port))
        except OSError as error:
            raise OSError(error.errno, error.strerror, self.address) from error
        listener.settimeout(0.0)
        self._listener, self._port = listener, listener.getsockname()[1]

    def pull(self) -> None:
        """Remove the gateway's power: all connections are reset or closed."""
        for client in [*self._clients, *self._forgotten]:
            client.socket.close()
        self._clients.clear()
        self._forgotten.clear()
        self._outgoing.clear()
        self._stalled_until_s = -math.inf
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def filenos(self, now_s: float) -> list[int]:
        if self._listener is None or now_s < self._stalled_until_s:
            return []
        return [self._listener.fileno(), *(client.socket.fileno() for client in self._clients)]

    def due_s(self, now_s: float) -> float:
        if now_s < self._stalled_until_s:
            return self._stalled_until_s
        return self._outgoing[0][0] if self._outgoing else math.inf

    def settings(self) -> MasterSettings | None:
        return None

    def hold_reply(self) -> bool:
        return False

    def stall(self, until_s: float) -> None:
        self._stalled_until_s = until_s

    def forget(self) -> None:
        self._forgotten += self._clients
        self._clients.clear()

    # --------------------------------------------------------------------------------- in detail
    def _accept(self) -> list[Client]:
        """Accept waiting clients, and return them."""
        fresh = []
        while self._listener is not None:
            try:
                accepted, _ = self._listener.accept()
            except BlockingIOError:
                break
            accepted.settimeout(0.0)
            accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            fresh.append(Client(accepted))
        self._clients += fresh
        return fresh

    def _receive(self, client: Client) -> bytes:
        """Return the bytes that a client sent. A closed connection is removed."""
        try:
            data = client.socket.recv(RECEIVE_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        return data

    def _drop(self, client: Client) -> None:
        client.socket.close()
        if client in self._clients:
            self._clients.remove(client)

    def _transmit(self, client: Client, data: bytes, now_s: float) -> None:
        """Send, in pieces or after a stall if a fault demands it."""
        pieces = [data]
        if self.segments_s > 0.0:
            size = max(1, -(-len(data) // PIECES))
            pieces = [data[at : at + size] for at in range(0, len(data), size)]
        due_s = max(now_s, self._stalled_until_s)
        if self._outgoing:
            due_s = max(due_s, self._outgoing[-1][0])
        for number, piece in enumerate(pieces):
            self._outgoing.append((due_s + number * self.segments_s, client, piece))
        self._flush(now_s)

    def _flush(self, now_s: float) -> None:
        while self._outgoing and now_s >= max(self._outgoing[0][0], self._stalled_until_s):
            _, client, data = self._outgoing.popleft()
            if client in self._clients:
                with contextlib.suppress(BlockingIOError, ConnectionError):
                    client.socket.send(data)


class RawTcpPort(TcpPort):
    """RTU frames as a stream. The newest connection has the line, and the previous one is closed:
    so a client that has lost its connection can connect again."""

    def take_in(self, now_s: float) -> bytes | None:
        if now_s < self._stalled_until_s:
            return b""
        self._flush(now_s)
        fresh = self._accept()
        for client in self._clients[:-1]:
            self._drop(client)
        if not self._clients:
            return None
        data = self._receive(self._clients[-1])
        return None if fresh and not data else data

    def put(self, data: bytes, now_s: float) -> int:
        if self._clients:
            self._transmit(self._clients[-1], data, now_s)
        return len(data)
