# SPDX-License-Identifier: Apache-2.0
"""A CAN interface of the kernel: is it there, is it up, and the way back from bus-off."""

from __future__ import annotations

import asyncio
from pathlib import Path

from motord_hal.can.address import split_address
from motord_hal.can.netlink import restart
from motord_hal.errors import PortError

IFF_UP = 0x1
"""linux/if.h"""
BUS_OFF_TEXT = (
    "bus-off: the controller has given up after too many errors (cable, termination, bit rate)"
)


def check_up(address: str) -> None:
    """Raises PortError: a socket on an interface that is down opens, and then says nothing. Other
    addresses than SocketCAN's are let through."""
    interface, channel = split_address(address)
    if interface != "socketcan":
        return
    flags = Path("/sys/class/net") / channel / "flags"
    try:
        up = int(flags.read_text(encoding="ascii"), 16) & IFF_UP
    except (OSError, ValueError):
        raise PortError(f"{address}: there is no such interface") from None
    if not up:
        how = f"ip link set {channel} up type can bitrate ..."
        raise PortError(f"{address} is down: {how}")


async def restart_controller(address: str) -> str:
    """Where it is permitted. Where it is not, the kernel may do it (restart-ms), or who may.
    Returns why it was refused, or nothing."""
    interface, channel = split_address(address)
    if interface == "socketcan":
        try:
            await asyncio.to_thread(restart, channel)  # at most ANSWER_WITHIN_S
        except OSError as error:
            return str(error)
    return ""
