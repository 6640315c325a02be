# SPDX-License-Identifier: Apache-2.0
"""A serial port as a stream in both directions on asyncio. Received bytes are handed on as they
come."""

from __future__ import annotations

import asyncio
import fcntl
import os
import termios
from collections.abc import Callable

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.serial.port import OpenPort, open_port

READ_BYTES = 4096
FRAMES_WAITING_MAX = 2


class Stream:
    """One port. The event loop calls `received` with the bytes that came."""

    def __init__(self, spec: LineSpec, received: Callable[[bytes], None]) -> None:
        self._spec = spec
        self._received = received
        self._port: OpenPort | None = None
        self._lost = ""

    def open(self) -> None:
        """Open the port, and close it first if it is open. Raises PortError."""
        self.close()
        self._port, self._lost = open_port(self._spec), ""
        self._port.flush()
        asyncio.get_running_loop().add_reader(self._port.fd, self._read)

    def close(self) -> None:
        """Close the port; does nothing if it is not open."""
        if self._port is not None:
            asyncio.get_running_loop().remove_reader(self._port.fd)
            self._port.close()
            self._port = None

    def _read(self) -> None:
        assert self._port is not None  # a reader without a port was removed
        try:
            data = os.read(self._port.fd, READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error.strerror or str(error))
            return
        if data:
            self._received(data)
        else:
            self._lose("end of file")

    def _lose(self, why: str) -> None:
        self._lost = why
        self.close()

    def send(self, data: bytes) -> bool:
        """Send data, unless older frames still wait: behind them it would come late. Return whether
        it was sent. Raises PortError."""
        if self._port is None:
            raise PortError(f"{self._spec.port} went away: {self._lost or 'it is closed'}")
        fd = self._port.fd
        try:
            waiting = int.from_bytes(fcntl.ioctl(fd, termios.TIOCOUTQ, bytes(4)), "little")
            if waiting > FRAMES_WAITING_MAX * len(data):
                return False
            return os.write(fd, data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            self._lose(error.strerror or str(error))
            raise PortError(f"{self._spec.port} went away: {self._lost}") from error
