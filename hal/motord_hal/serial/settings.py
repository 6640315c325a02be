# SPDX-License-Identifier: Apache-2.0
"""Raw termios for any baud rate. Settings are read back: a driver may set less than requested.

Sources: termios(3), ioctl_tty(2); struct termios2 and BOTHER: linux asm-generic/termbits.h.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import termios
from types import MappingProxyType

_TCGETS2 = 0x802C542A
_TCSETS2 = 0x402C542B
_TERMIOS2 = struct.Struct("=4IB19s2I")
_BOTHER = 0o010000
_CBAUD = 0o010017
_INPUT_BAUD_SHIFT = 16
_PTY_MAJORS = range(136, 144)
"""Major numbers of Unix98 pty slaves: Documentation/admin-guide/devices.txt."""
BAUDRATE_TOLERANCE = 0.02
"""Greatest relative error. A receiver samples mid-bit: half a bit in ten, shared by both ends,
leaves about 2 % to each."""
PARITY = MappingProxyType(
    {"none": 0, "even": termios.PARENB, "odd": termios.PARENB | termios.PARODD}
)
_FRAMING = termios.CSIZE | termios.CSTOPB | termios.PARENB | termios.PARODD


def is_pty(fd: int) -> bool:
    """Whether it is a pseudo-terminal: it has no wire, so it keeps no parity
    (drivers/tty/pty.c)."""
    return os.major(os.fstat(fd).st_rdev) in _PTY_MAJORS


def set_raw(fd: int, baudrate: int, parity: str, stop_bits: int) -> None:
    """Set eight data bits, raw, no flow control, no modem lines. Raises OSError, termios.error, or
    ValueError with the setting that the driver did not take."""
    stop = termios.CSTOPB if stop_bits == 2 else 0
    control = termios.CS8 | termios.CLOCAL | termios.CREAD | stop | PARITY[parity]
    speed = getattr(termios, f"B{baudrate}", None)
    characters: list[bytes | int] = [b"\0"] * 32
    standard = termios.B9600 if speed is None else speed
    termios.tcsetattr(fd, termios.TCSANOW, [0, 0, control, 0, standard, standard, characters])
    if speed is None:
        _set_odd_speed(fd, baudrate)
    _check(fd, baudrate, control)


def _set_odd_speed(fd: int, baudrate: int) -> None:
    fields = list(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))))
    fields[2] = fields[2] & ~(_CBAUD | _CBAUD << _INPUT_BAUD_SHIFT) | _BOTHER
    fields[6] = fields[7] = baudrate
    fcntl.ioctl(fd, _TCSETS2, _TERMIOS2.pack(*fields))


def _check(fd: int, baudrate: int, control: int) -> None:
    fields = _TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size)))
    kept, speed = fields[2], fields[7]
    if abs(speed - baudrate) > BAUDRATE_TOLERANCE * baudrate:
        raise ValueError(f"the driver set {speed} baud, not {baudrate}")
    if not is_pty(fd) and (kept ^ control) & _FRAMING:
        raise ValueError("the driver does not take this parity or these stop bits")


def claim(fd: int) -> None:
    """Make the port exclusive: TIOCEXCL keeps other openers out, the lock those that may pass it
    (root). Raises OSError."""
    fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    fcntl.ioctl(fd, termios.TIOCEXCL)


def busy(error: OSError) -> bool:
    """Whether this error means that another program has claimed the port."""
    return error.errno in (errno.EBUSY, errno.EWOULDBLOCK)
