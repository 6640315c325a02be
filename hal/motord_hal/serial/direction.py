# SPDX-License-Identifier: Apache-2.0
"""Direction of an RS485 transceiver that the UART's own driver switches.

Source: kernel, Documentation/driver-api/serial/serial-rs485.rst and include/uapi/linux/serial.h.
"""

from __future__ import annotations

import fcntl
import math
import struct

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import DirectionSpec

_TIOCGRS485 = 0x542E
_TIOCSRS485 = 0x542F
_RS485 = struct.Struct("=3I20x")
_ENABLED, _RTS_ON_SEND, _RTS_AFTER_SEND, _RX_DURING_TX = 1, 2, 4, 16
_DELAY_MAX_MS = 100
"""Longest delay that the serial core accepts (RS485_MAX_RTS_DELAY)."""


def pack_rs485(spec: DirectionSpec) -> bytes:
    """Return struct serial_rs485. Delays are rounded up to whole milliseconds. Raises
    ValueError."""
    delays_ms = []
    for delay_s in (spec.before_s, spec.after_s):
        if not 0.0 <= delay_s <= _DELAY_MAX_MS * 1e-3:
            raise ValueError(f"a delay of {delay_s} s (0 to {_DELAY_MAX_MS * 1e-3:g} s)")
        delays_ms.append(math.ceil(round(delay_s * 1e3, 6)))
    level = _RTS_ON_SEND if spec.active_high else _RTS_AFTER_SEND
    return _RS485.pack(_ENABLED | level, *delays_ms)


def kept_problem(asked: bytes, kept: bytes) -> str:
    """Return the settings that the driver changed, in words; "": no important one."""
    flags, *delays_ms = _RS485.unpack(asked)
    kept_flags, *kept_delays_ms = _RS485.unpack(kept)
    if not kept_flags & _ENABLED:
        return "the driver did not switch it on"
    if (flags ^ kept_flags) & (_RTS_ON_SEND | _RTS_AFTER_SEND):
        return "the driver does not take this polarity"
    if kept_flags & _RX_DURING_TX:
        return "the driver goes on receiving while it sends"
    if any(kept_ms < ms for ms, kept_ms in zip(delays_ms, kept_delays_ms, strict=True)):
        return f"the driver keeps delays of {kept_delays_ms} ms, requested were {delays_ms}"
    return ""


def set_kernel_direction(fd: int, port: str, spec: DirectionSpec) -> None:
    """Make the driver turn the transceiver, and check its settings. Raises PortError."""
    try:
        asked = pack_rs485(spec)
        fcntl.ioctl(fd, _TIOCSRS485, asked)
        kept = fcntl.ioctl(fd, _TIOCGRS485, bytes(_RS485.size))
    except ValueError as error:
        raise PortError(f"{port}: {error}") from error
    except OSError as error:
        raise PortError(
            f'{port}: direction "kernel" is not offered by this port ({error.strerror}). Enable '
            "RS485 of the UART in its device-tree overlay, or take an adapter that turns itself "
            '(direction = "auto"), or turn the transceiver by a GPIO line (direction = "gpio")'
        ) from error
    if problem := kept_problem(asked, kept):
        raise PortError(f'{port}: direction "kernel": {problem}')
