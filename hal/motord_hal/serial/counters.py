# SPDX-License-Identifier: Apache-2.0
"""What the UART's driver counted, and what it says about a drive that is quiet.

Source: kernel, include/uapi/linux/serial.h (struct serial_icounter_struct), ioctl TIOCGICOUNT.
"""

from __future__ import annotations

import fcntl
import struct
from dataclasses import dataclass

_TIOCGICOUNT = 0x545D
_ICOUNTER = struct.Struct("=20i")


@dataclass(frozen=True, slots=True)
class Counters:
    """Since the driver was loaded."""

    received: int
    framing: int
    overrun: int
    parity: int


def read_counters(fd: int) -> Counters | None:
    """None where the driver does not count (pseudo-terminals, some adapters)."""
    try:
        raw = _ICOUNTER.unpack(fcntl.ioctl(fd, _TIOCGICOUNT, bytes(_ICOUNTER.size)))
    except OSError:
        return None
    return Counters(received=raw[4], framing=raw[6], overrun=raw[7], parity=raw[8])


def _times(count: int, what: str) -> str:
    return f"{count} {what} error{'' if count == 1 else 's'}"


def quiet_hint(before: Counters | None, after: Counters | None, noise_bytes: int = 0) -> str:
    """Why a drive may be quiet, to stand behind "is quiet"; empty: nothing hints at anything.
    `noise_bytes` came since `before` and belonged to no answer."""
    if before is not None and after is not None:
        framing, parity = after.framing - before.framing, after.parity - before.parity
        if parity > 0 and parity >= framing:
            return f"{_times(parity, 'parity')}: parity or stop bits differ"
        if framing > 0:
            return f"{_times(framing, 'framing')}: baud rate or stop bits differ"
        if after.overrun > before.overrun:
            lost = _times(after.overrun - before.overrun, "overrun")
            return f"{lost}: this machine lost bytes"
    if noise_bytes > 0:
        return "bytes came, but no frame: baud rate or parity?"
    return ""
