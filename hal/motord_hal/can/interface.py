# SPDX-License-Identifier: Apache-2.0
"""Checks of a CAN interface of the kernel (present, up, able to carry CAN FD, not bus-off), and its
restart after bus-off. Addresses other than SocketCAN's are not examined."""

from __future__ import annotations

import asyncio
from collections import Counter
from pathlib import Path

from motord_hal.base.clock import now_s
from motord_hal.base.errors import PortError
from motord_hal.can.address import split_address
from motord_hal.can.netlink import BUS_OFF, can_state, restart

NET = Path("/sys/class/net")
IFF_UP = 0x1
"""Flag of an interface that is up, from linux/if.h."""
CANFD_MTU = 72
"""MTU of an interface that carries CAN FD, from linux/can.h; 16 is one that does not."""
ARPHRD_CAN = "280"
"""Type of an interface for CAN, from linux/if_arp.h."""
CAN_TABLES = Path("/proc/net/can")
"""Exists while the kernel's module `can` is loaded."""
LOOK_EVERY_S = 0.5
_PORT = "/dev/ttyUSB0"
BUS_OFF_TEXT = (
    "bus-off: the controller has given up after too many errors (cable, termination, bit rate)"
)


async def make_ready(address: str, errors: Counter[str], *, fd_frames: bool) -> None:
    """Check that the interface is usable, and restart a controller that is bus-off where permitted.
    Otherwise the kernel (restart-ms) or a user may restart it. Refusals are counted. Raises
    PortError if it is down or bus-off: a socket opens on such an interface, too, and then receives
    nothing."""
    interface, channel = split_address(address)
    if interface != "socketcan":
        return
    if not _number(channel, "flags", address, 16) & IFF_UP:
        how = f"ip link set {channel} up type can bitrate ..."
        raise PortError(f"{address} is down: {how}")
    if fd_frames and _number(channel, "mtu", address, 10) < CANFD_MTU:
        how = f"ip link set {channel} type can bitrate ... dbitrate ... fd on"
        raise PortError(f"{address} carries no CAN FD, which the robot file needs: {how}")
    refused = await asyncio.to_thread(_restart_if_off, channel)  # at most twice ANSWER_WITHIN_S
    if refused:
        errors["restart_refused"] += 1
        how = f"ip link set {channel} type can restart, or restart-ms of the interface"
        raise PortError(f"{address}: {BUS_OFF_TEXT}; not restarted ({refused}): {how}")


def _number(channel: str, name: str, address: str, base: int) -> int:
    try:
        return int((NET / channel / name).read_text(encoding="ascii"), base)
    except (OSError, ValueError):
        raise PortError(f"{address}: {missing(channel)}") from None


def exists(channel: str) -> bool:
    """Return whether the kernel has an interface of this name."""
    return (NET / channel).exists()


def missing(channel: str) -> str:
    """Return the text about a CAN interface that the kernel does not have."""
    names = sorted(path.parent.name for path in NET.glob("*/type") if _is_can(path))
    if names:
        here = f"those here: {', '.join(names)}"
    elif not CAN_TABLES.exists():
        here = "this kernel has no CAN yet: `modprobe can_raw`, and the driver of your adapter"
    else:
        here = "this machine has none"
    return f"there is no CAN interface {channel} ({here}); a serial port is a path such as {_PORT}"


def _is_can(path: Path) -> bool:
    try:
        return path.read_text(encoding="ascii").strip() == ARPHRD_CAN
    except OSError:
        return False


def _restart_if_off(channel: str) -> str:
    """Restart the controller if it is bus-off. Return why that was refused; "": it was not."""
    try:
        if can_state(channel) == BUS_OFF:
            restart(channel)
    except OSError as error:
        return str(error)
    return ""


class BusOffWatch:
    """Watch for a controller that is bus-off although no error frame has reported it: that frame
    may have been lost."""

    def __init__(self, address: str) -> None:
        interface, self._channel = split_address(address)
        self._next_s = 0.0 if interface == "socketcan" else float("inf")

    def is_off(self) -> bool:
        """Whether it is bus-off, checked every LOOK_EVERY_S. Only an interface without a carrier
        can be bus-off, so the kernel is queried only then; that may take
        ANSWER_WITHIN_S."""
        if now_s() < self._next_s:
            return False
        self._next_s = now_s() + LOOK_EVERY_S
        try:
            carrier = (NET / self._channel / "carrier").read_text(encoding="ascii")
            return carrier.strip() == "0" and can_state(self._channel) == BUS_OFF
        except OSError:  # down or gone: its socket reports it
            return False
