# SPDX-License-Identifier: Apache-2.0
"""A CAN bus on this machine without CAN in the kernel: a SOCK_SEQPACKET socket at a path, whose
datagrams are struct can_frame and canfd_frame (linux/can.h). Its creator receives all frames; what
one client sends, all others receive. Nothing waits: a reader whose buffer is full loses the frame,
as on a CAN bus.

One thread may receive; any number may send and close. A socket is closed under the lock that its
users hold, so no thread uses a descriptor that is closed, or that belongs to another file by
then."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import threading
import time

import can

from motord_hal.can.socket_frames import FRAME_BYTES_MAX, packed, unpacked

_LATEST = 128
"""Greatest number of connections that wait to be accepted."""


class UnixBus(can.BusABC):
    """The CAN bus itself, from the simulator's side."""

    def __init__(self, path: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        self._path = path
        self._receiving = threading.Lock()
        """Guards the listening socket, the poll set and the event. It is taken before
        `_sending`."""
        self._sending = threading.Lock()
        """Guards the clients' sockets."""
        self._clients: dict[int, socket.socket] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._listener.bind(path)
        self._listener.listen(_LATEST)
        self._closing = os.eventfd(0)
        self._ready = select.epoll()
        self._ready.register(self._listener, select.EPOLLIN)
        self._ready.register(self._closing, select.EPOLLIN)
        super().__init__(channel=path)

    def fileno(self) -> int:
        """Return a descriptor that is readable when there is something to receive."""
        return self._ready.fileno()

    def shutdown(self) -> None:
        """End a waiting `recv`, wait for every thread that is inside, and close. Later calls of
        `recv` and `send` raise CanOperationError."""
        if self._is_shutdown:
            return
        super().shutdown()
        os.eventfd_write(self._closing, 1)
        with self._receiving, self._sending:
            for client in self._clients.values():
                client.close()
            self._clients.clear()
            self._ready.close()
            self._listener.close()
            os.close(self._closing)
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        del timeout
        self._spread(packed(msg), None)

    def _spread(self, frame: bytes, sender: socket.socket | None) -> None:
        with self._sending:
            self._check_open()
            for client in self._clients.values():
                if client is not sender:
                    with contextlib.suppress(
                        BlockingIOError, BrokenPipeError, ConnectionResetError
                    ):
                        client.send(frame)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        with self._receiving:
            self._check_open()
            for fd, _ in self._ready.poll(-1.0 if timeout is None else timeout):
                self._check_open()
                if fd == self._listener.fileno():
                    self._accept()
                elif (message := self._take(self._clients[fd])) is not None:
                    return message, False
        return None, False

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError(f"the CAN bus at {self._path} is closed")

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        client.settimeout(0.0)
        with self._sending:
            self._clients[client.fileno()] = client
        self._ready.register(client, select.EPOLLIN)

    def _take(self, client: socket.socket) -> can.Message | None:
        try:
            frame = client.recv(FRAME_BYTES_MAX)
        except (BlockingIOError, ConnectionResetError):
            frame = b""
        if not frame:
            self._ready.unregister(client)
            with self._sending:
                del self._clients[client.fileno()]
                client.close()
            return None
        try:
            message = unpacked(frame, time.time())
        except struct.error:  # not a frame: no node on a CAN bus would receive it
            return None
        self._spread(frame, client)
        return message
