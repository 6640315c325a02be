# SPDX-License-Identifier: Apache-2.0
"""Reading of the kernel's error frames (linux/can/error.h). Pure."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from types import MappingProxyType

_BUS_OFF = 0x040
_KINDS = (
    (0x002, "lost_arbitration"),
    (0x008, "protocol"),
    (0x010, "transceiver"),
    (0x020, "no_ack"),
    (_BUS_OFF, "bus_off"),
    (0x080, "bus_error"),
    (0x100, "restarted"),
)
_CONTROLLER = 0x004
_OVERFLOW, _PASSIVE = 0x03, 0x30
"""Bits of byte 1: receive or transmit buffer overflowed; receiver or sender is error-passive."""


WARN_EVERY_S = 60.0
"""Shortest time between two equal log lines while the errors go on."""
_WARNINGS = MappingProxyType(
    {
        "error_passive": "error-passive: many frames fail (cable, termination, bit rate)",
        "no_ack": "no node acknowledges its frames (cable, drives without power, bit rate)",
    }
)


class BusTrouble(enum.Enum):
    NONE = "none"
    BUS_OFF = "bus_off"


def error_words(identifier: int, data: bytes) -> tuple[list[str], BusTrouble]:
    """Return the kinds of errors in the frame, and whether the controller has left the CAN bus."""
    kinds = [name for bit, name in _KINDS if identifier & bit]
    if identifier & _CONTROLLER and len(data) > 1:
        if data[1] & _OVERFLOW:
            kinds.append("overflow")
        if data[1] & _PASSIVE:
            kinds.append("error_passive")
    off = identifier & _BUS_OFF
    return kinds or ["error_frame"], BusTrouble.BUS_OFF if off else BusTrouble.NONE


class BusWarnings:
    """Warnings that follow from error frames. Each kind appears once in WARN_EVERY_S."""

    def __init__(self) -> None:
        self._reported_s: dict[str, float] = {}

    def new(self, kinds: Iterable[str], now_s: float) -> list[str]:
        """Return the warnings to log now for these kinds of errors."""
        found = []
        for kind in kinds:
            if (
                kind in _WARNINGS
                and now_s - self._reported_s.get(kind, -WARN_EVERY_S) >= WARN_EVERY_S
            ):
                self._reported_s[kind] = now_s
                found.append(_WARNINGS[kind])
        return found
