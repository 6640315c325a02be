# SPDX-License-Identifier: Apache-2.0
"""A serial port of pyserial under the asyncio transport of pyserial-asyncio-fast.

It works around four problems of pyserial 3.5 and pyserial-asyncio-fast 0.16:

- pyserial tries for ever, in the event loop, if a non-blocking port is full;
- the transport closes the port later and in a thread, and the next opener would find it taken;
- before that it waits until everything has gone out, which never ends if the port is stuck;
- a write that fails because the adapter went away is logged as a mistake of the program.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import termios
import threading

from serial import Serial, SerialException
from serial_asyncio_fast import SerialTransport

from motord_hal.base.errors import PortError
from motord_hal.serial.port import reason

READ_BYTES = 4096
WAITING_BYTES_MAX = 256
"""Limit for waiting bytes: the longest frame of MODBUS over Serial Line (V1.02, 2.5.1). One request
is sent at a time: if more than one waits, the port is stuck."""
_PARITY = {"none": "N", "even": "E", "odd": "O"}


class LoopPort(Serial):
    """An exclusive port; received bytes go to `protocol`."""

    def __init__(
        self,
        path: str,
        baudrate: int,
        parity: str,
        stop_bits: int,
        protocol: asyncio.Protocol,
    ) -> None:
        """Open the port. Raises PortError."""
        self._one_closes = threading.Lock()
        self._failed = ""
        try:
            super().__init__(
                path, baudrate, 8, _PARITY[parity], stop_bits, timeout=0, exclusive=True
            )
            # it configures the port again: a driver may then refuse what it took before
            self.transport = SerialTransport(asyncio.get_running_loop(), protocol, self)
        except OSError as error:  # also of pyserial, for a port that went away meanwhile
            self.close()
            why = "it is no serial port"
            if error.errno:  # the type that an errno has in Python
                why = reason(path, OSError(error.errno, os.strerror(error.errno)))
            raise PortError(f"{path} cannot be opened: {why}") from error
        except (ValueError, termios.error) as error:
            self.close()
            raise PortError(
                f"{path} does not take {baudrate} baud, parity {parity}: {error}"
            ) from error

    @property
    def is_usable(self) -> bool:
        """Whether the port can be used. False is final: the port went away, or was closed."""
        return not self.transport.is_closing() and not self._failed

    @property
    def is_stuck(self) -> bool:
        """Whether a usable port holds bytes that should have gone out long ago."""
        if not self.is_usable:
            return False
        if self.transport.get_write_buffer_size():
            return True
        try:
            return self.out_waiting > WAITING_BYTES_MAX
        except OSError:
            return False  # the port is lost, and the reader will find that

    def drain(self) -> bytes:
        """Return received bytes that were not handed on yet. Raises PortError."""
        try:
            return bytes(self.read(READ_BYTES))
        except SerialException as error:
            raise PortError(f"{self.name} went away: {error}") from error

    def let_go(self) -> None:
        """Close the port at once. If it is stuck, unsent bytes are dropped."""
        if self.is_stuck:
            with contextlib.suppress(termios.error):
                self.reset_output_buffer()
        self.transport.flush()  # a port that closed by itself may still have bytes to write
        if not self.transport.is_closing():
            self.transport.abort()
        self.close()

    # ------------------------------------------------------------------- what the transport calls
    def write(self, data: bytes) -> int:  # type: ignore[override]  # of what pymodbus sends
        """Write without waiting. If the port is full, the transport gets BlockingIOError."""
        try:
            return os.write(self.fileno(), data)
        except BlockingIOError:
            raise
        except OSError as error:
            self._failed = error.strerror or str(error)
            return len(data)

    def flush(self) -> None:
        """Do not wait for unsent bytes."""

    def close(self) -> None:
        """Close as Serial.close does, which two threads must not enter: a descriptor that is closed
        twice may belong to another file by then."""
        with self._one_closes:
            super().close()
