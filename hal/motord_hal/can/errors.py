# SPDX-License-Identifier: Apache-2.0
"""What an error frame of the kernel says (linux/can/error.h). Pure."""

from __future__ import annotations

import enum

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
"""Of byte 1: receive or transmit buffer overflowed; receiver or sender is error-passive."""


class BusTrouble(enum.Enum):
    NONE = "none"
    BUS_OFF = "bus_off"


def error_words(identifier: int, data: bytes) -> tuple[list[str], BusTrouble]:
    """The kinds of errors that the frame names, and whether the controller has left the bus."""
    kinds = [name for bit, name in _KINDS if identifier & bit]
    if identifier & _CONTROLLER and len(data) > 1:
        if data[1] & _OVERFLOW:
            kinds.append("overflow")
        if data[1] & _PASSIVE:
            kinds.append("error_passive")
    off = identifier & _BUS_OFF
    return kinds or ["error_frame"], BusTrouble.BUS_OFF if off else BusTrouble.NONE
