# SPDX-License-Identifier: Apache-2.0
"""unix:PATH for python-can: a SOCK_SEQPACKET socket that carries SocketCAN's frames."""

from __future__ import annotations

import errno
import select
import socket
import struct

import can

from motord_hal.can.socket_frames import FRAME_BYTES_MAX, packed, unpacked

SO_TIMESTAMPNS = 35
"""Socket option for the kernel's time of arrival with each frame, from asm-generic/socket.h."""
_TIME = struct.Struct("@ll")
"""struct timespec"""
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIME.size)


class UnixClient(can.BusABC):
    """A program's connection to a CAN bus at a Unix socket."""

    def __init__(self, path: str) -> None:
        """Connect. Raises OSError if no CAN bus is there."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            self._socket.connect(path)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        except OSError:
            self._socket.close()
            raise
        super().__init__(channel=path)

    def fileno(self) -> int:
        return self._socket.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        self._socket.close()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send without waiting. Raises OSError; BlockingIOError if the CAN bus takes nothing
        now."""
        del timeout
        self._socket.send(packed(msg))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if timeout != 0 and not select.select([self._socket], [], [], timeout)[0]:
            return None, False
        try:
            frame, ancillary, _, _ = self._socket.recvmsg(FRAME_BYTES_MAX, _ANCILLARY_BYTES)
        except BlockingIOError:
            return None, False
        if not frame:
            raise can.CanOperationError("the program that made the CAN bus has ended", errno.ENODEV)
        ((_, _, stamp),) = ancillary
        seconds, nanoseconds = _TIME.unpack(stamp)
        try:
            return unpacked(frame, seconds + nanoseconds * 1e-9), False
        except struct.error as error:
            raise can.CanOperationError(f"no frame: {error}") from error
