# SPDX-License-Identifier: Apache-2.0
"""The socket of a CAN bus for its thread: a SocketCAN socket, or, for unix:PATH, a SOCK_SEQPACKET
socket that carries the same frames (simulators, tests, programs in place of a CAN bus)."""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Iterable

from motord_hal.base.errors import PortError
from motord_hal.can.address import split_address
from motord_hal.can.unix_client import SO_TIMESTAMPNS
from motord_hal.realtime.can import EXTENDED, REMOTE

_FILTER = struct.Struct("=II")
"""Layout of struct can_filter: identifier, mask."""
_CAN_RAW_ERR_FILTER = 2
"""Socket option from linux/can/raw.h."""
_CAN_RAW_RECV_OWN_MSGS = 4
"""Socket option from linux/can/raw.h."""
_ERRORS_ALL = 0x1FFF_FFFF
"""Mask of all error frames: CAN_ERR_MASK of linux/can/error.h."""


def open_socket(address: str, identifiers: Iterable[int], *, fd_frames: bool) -> socket.socket:
    """Open a non-blocking socket on the CAN bus for frames with these identifiers, each with its
    flag bits. A SocketCAN socket also receives its own frames
    once they were sent. Raise PortError if the socket cannot be opened."""
    interface, channel = split_address(address)
    try:
        if interface == "unix":
            return _connected(channel)
        return _bound(channel, identifiers, fd_frames=fd_frames)
    except OSError as error:
        words = errno.errorcode.get(error.errno or 0, "")
        raise PortError(f"{address}: {error.strerror} ({words})") from error


def _connected(path: str) -> socket.socket:
    bus = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
    try:
        bus.connect(path)
        bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    except OSError:
        bus.close()
        raise
    return bus


def _bound(channel: str, identifiers: Iterable[int], *, fd_frames: bool) -> socket.socket:
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
    try:
        filters = b"".join(map(_filter, identifiers))
        bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        bus.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ERRORS_ALL)
        bus.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_RECV_OWN_MSGS, 1)
        if fd_frames:
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        bus.bind((channel,))
    except OSError:
        bus.close()
        raise
    return bus


def _filter(identifier: int) -> bytes:
    number = 0x1FFF_FFFF if identifier & EXTENDED else 0x7FF
    return _FILTER.pack(identifier, number | EXTENDED | REMOTE)
