# SPDX-License-Identifier: Apache-2.0
"""Removal of an adapter's delay: ASYNC_LOW_LATENCY, and the latency timer of FTDI chips.

Sources: kernel, include/uapi/linux/serial.h and tty_flags.h; drivers/usb/serial/ftdi_sio.c
(latency_timer: 1 to 255 ms, 16 as delivered; FTDI AN232B-04).
"""

from __future__ import annotations

import fcntl
import os
import struct
import termios
from pathlib import Path

_FLAGS_OFFSET = 16
"""Position in struct serial_struct: after type, line, port and irq."""
_SERIAL_STRUCT_BYTES = 128
"""Buffer size, larger than struct serial_struct on any architecture."""
_ASYNC_LOW_LATENCY = 1 << 13
_TIMER_MS = 1
UDEV_LINE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


def ask_low_latency(fd: int) -> bool:
    """Request low latency. Return whether the driver now hands bytes on at once; False: it has no
    such flag."""
    state = bytearray(_SERIAL_STRUCT_BYTES)
    try:
        fcntl.ioctl(fd, termios.TIOCGSERIAL, state)
        flags = struct.unpack_from("=i", state, _FLAGS_OFFSET)[0]
        struct.pack_into("=i", state, _FLAGS_OFFSET, flags | _ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, termios.TIOCSSERIAL, state)
    except OSError:
        return False  # many drivers have no such flag, and work without
    return True


def shorten_latency_timer(device: str, sys: Path = Path("/sys")) -> str:
    """Set an FTDI adapter's timer to 1 ms. Return a remaining problem in a sentence; "": no
    problem."""
    name = Path(os.path.realpath(device)).name
    timer = sys / "class" / "tty" / name / "device" / "latency_timer"
    try:
        before_ms = int(timer.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return ""  # no FTDI chip
    if before_ms <= _TIMER_MS:
        return ""
    try:
        timer.write_text(f"{_TIMER_MS}\n", encoding="ascii")
        after_ms = int(timer.read_text(encoding="ascii"))
    except (OSError, ValueError):
        after_ms = before_ms
    if after_ms <= _TIMER_MS:
        return ""
    return (
        f"{device} holds bytes back for up to {after_ms} ms (FTDI latency timer) and motord may "
        f"not change it; a udev rule fixes it: {UDEV_LINE}"
    )
