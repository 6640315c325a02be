# SPDX-License-Identifier: Apache-2.0
"""struct can_frame and struct canfd_frame (linux/can.h), as SocketCAN's sockets carry them."""

from __future__ import annotations

import struct
from typing import Any

import can

_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBB2x64s")
FRAME_BYTES_MAX = _FD.size
_EXTENDED, _REMOTE, _ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_NUMBER = 0x1FFF_FFFF


def packed(message: can.Message) -> bytes:
    """Return the message as the kernel's struct."""
    identifier = message.arbitration_id | _EXTENDED * message.is_extended_id
    identifier |= _REMOTE * message.is_remote_frame | _ERROR * message.is_error_frame
    if message.is_fd:
        flags = int(message.bitrate_switch)
        return _FD.pack(identifier, len(message.data), flags, bytes(message.data))
    return _CLASSIC.pack(identifier, message.dlc, bytes(message.data))


def unpacked(frame: bytes, came_s: float) -> can.Message:
    """Return the message in a kernel's struct. Raises struct.error if it is not a frame."""
    values: dict[str, Any] = {"timestamp": came_s}
    if len(frame) == _FD.size:
        identifier, size, flags, data = _FD.unpack(frame)
        values |= {"is_fd": True, "bitrate_switch": bool(flags & 1)}
    else:
        identifier, size, data = _CLASSIC.unpack(frame)
    remote = bool(identifier & _REMOTE)
    return can.Message(
        arbitration_id=identifier & _NUMBER,
        is_extended_id=bool(identifier & _EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(identifier & _ERROR),
        dlc=size,
        data=None if remote else data[:size],
        **values,
    )
