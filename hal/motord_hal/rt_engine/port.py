# SPDX-License-Identifier: Apache-2.0
"""Opens a serial port for a line's thread: raw, and for nobody else."""

from __future__ import annotations

import fcntl
import os
import termios
from dataclasses import dataclass
from types import MappingProxyType

from motord_hal.errors import PortError
from motord_hal.ports import LineSpec

_PARITY = MappingProxyType(
    {"none": 0, "even": termios.PARENB, "odd": termios.PARENB | termios.PARODD}
)


@dataclass(slots=True)
class OpenPort:
    fd: int
    de_fd: int = -1

    def close(self) -> None:
        os.close(self.fd)


def open_port(spec: LineSpec) -> OpenPort:
    """Raises PortError."""
    try:
        fd = os.open(spec.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise PortError(f"{spec.port} cannot be opened: {error.strerror}") from error
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        fcntl.ioctl(fd, termios.TIOCEXCL)
        speed = getattr(termios, f"B{spec.baudrate}")
        stop = termios.CSTOPB if spec.stop_bits == 2 else 0
        control = termios.CS8 | termios.CLOCAL | termios.CREAD | stop | _PARITY[spec.parity]
        termios.tcsetattr(fd, termios.TCSANOW, [0, 0, control, 0, speed, speed, [b"\0"] * 32])
    except (OSError, AttributeError, termios.error) as error:
        os.close(fd)
        raise PortError(f"{spec.port} cannot be set up: {error}") from error
    return OpenPort(fd)
