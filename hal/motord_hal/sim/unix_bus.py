# SPDX-License-Identifier: Apache-2.0
"""A CAN bus on this machine without CAN in the kernel: a SOCK_SEQPACKET socket at a path, whose
datagrams are struct can_frame and canfd_frame (linux/can.h). Who made it hears all; what one says
all others hear. Nothing waits: a reader whose buffer is full loses the frame, as on a bus."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time

import can

from motord_hal.can.socket_frames import FRAME_BYTES_MAX, packed, unpacked

_LATEST = 128
"""Connections that wait to be taken in."""


class UnixBus(can.BusABC):
    """The bus itself, seen from who simulates it."""

    def __init__(self, path: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        self._path = path
        self._clients: dict[int, socket.socket] = {}
        self._door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._door.bind(path)
        self._door.listen(_LATEST)
        self._ready = select.epoll()
        self._ready.register(self._door, select.EPOLLIN)
        super().__init__(channel=path)

    def fileno(self) -> int:
        """Readable where there is something to be taken in."""
        return self._ready.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        self._ready.close()
        self._door.close()
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        del timeout
        self._spread(packed(msg), None)

    def _spread(self, frame: bytes, sender: socket.socket | None) -> None:
        for client in list(self._clients.values()):
            if client is not sender:
                with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionResetError):
                    client.send(frame)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        wait_s = -1.0 if timeout is None else timeout
        for fd, _ in self._ready.poll(wait_s):
            if fd == self._door.fileno():
                client, _ = self._door.accept()
                client.settimeout(0.0)
                self._clients[client.fileno()] = client
                self._ready.register(client, select.EPOLLIN)
                continue
            if (message := self._take(self._clients[fd])) is not None:
                return message, False
        return None, False

    def _take(self, client: socket.socket) -> can.Message | None:
        try:
            frame = client.recv(FRAME_BYTES_MAX)
        except (BlockingIOError, ConnectionResetError):
            frame = b""
        if not frame:
            self._ready.unregister(client)
            del self._clients[client.fileno()]
            client.close()
            return None
        self._spread(frame, client)
        return unpacked(frame, time.time())
