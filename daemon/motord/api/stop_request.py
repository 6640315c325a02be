# SPDX-License-Identifier: Apache-2.0
"""Stop, emergency stop and disarm as a datagram that the real-time loop itself reads:
docs/commands.md. It needs no connection, so no other client can block it.

It needs the standard library alone. Layout: stop_request in csrc/api/api.h."""

from __future__ import annotations

import errno
import socket
import struct
import time
from pathlib import Path

MAGIC = 0x5153544D
VERSION = 1
KINDS = {"stop": 0, "estop": 1, "disarm": 2}
"""Number of each request, by the method of the local socket."""
AGAIN_S = 0.001
_LAYOUT = struct.Struct("=IHH")
_FULL = (errno.EAGAIN, errno.ENOBUFS, errno.ENOMEM, errno.EINTR)


def datagram(method: str) -> bytes:
    """Return the datagram for a method of KINDS."""
    return _LAYOUT.pack(MAGIC, VERSION, KINDS[method])


def stop_socket(local_socket: Path) -> Path:
    """Return the socket for stop requests of the daemon with this local socket."""
    return local_socket.with_name(f"{local_socket.name.removesuffix('.sock')}.stop.sock")


def page_link(local_socket: Path) -> Path:
    """Return the link to the daemon's state page, beside its local socket."""
    return local_socket.with_name(f"{local_socket.name.removesuffix('.sock')}.page")


def open_sender() -> socket.socket:
    """Return an unconnected socket: it stays usable when the daemon restarts, and sending needs no
    further descriptor."""
    return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)


def try_send(sender: socket.socket, local_socket: Path, method: str) -> bool:
    """Send the request once. False: the receive queue is full, try again. Raises OSError for any
    other failure: no daemon receives there, or this user may not stop it."""
    try:
        sender.sendto(datagram(method), str(stop_socket(local_socket)))
    except OSError as error:
        if error.errno in _FULL:
            return False
        raise
    return True


def send(local_socket: Path, method: str, within_s: float) -> None:
    """Send the request; retry while the receive queue is full. Raises OSError and TimeoutError."""
    end_s = time.monotonic() + within_s
    with open_sender() as sender:
        while not try_send(sender, local_socket, method):
            if time.monotonic() > end_s:
                raise TimeoutError(errno.ETIMEDOUT, "the receive queue stays full")
            time.sleep(AGAIN_S)
