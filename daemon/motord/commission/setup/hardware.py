# SPDX-License-Identifier: Apache-2.0
"""Ports to which drives can be connected: serial ports, CAN interfaces, PWM chips."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from motord_hal.can.netlink import bit_rate
from motord_hal.serial.sysfs import usb_ports

ARPHRD_CAN = "280"
"""Type of a CAN interface in Linux: include/uapi/linux/if_arp.h."""
FD_BITRATE = 5_000_000
"""Bit rate that CAN FD transceivers of drives can carry."""
USUAL_BITRATE = 500_000
"""Bit rate of a CAN bus whose adapter does not report it."""
CANFD_MTU = "72"
"""MTU of a CAN FD interface in Linux: include/uapi/linux/can.h."""
BOARD_PORTS = ("ttyAMA*", "ttyTHS*", "ttymxc*", "serial[0-9]*")
"""UARTs on the pins of a board. The ttyS of a PC are left out: most of them have no hardware."""


@dataclass(frozen=True, slots=True)
class Place:
    """A port or interface on which a line can be opened."""

    kind: Literal["serial", "can", "pwm"]
    name: str
    """Name in the form of the robot file."""
    about: str


def places(root: Path = Path("/")) -> list[Place]:
    """Return all places, by names that stay the same after a restart where there are such names."""
    found = [
        Place("serial", _stable(root, port.device), port.description or "") for port in usb_ports()
    ]
    for pattern in BOARD_PORTS:
        found += [
            Place("serial", f"/{port.relative_to(root)}", "UART of the board")
            for port in sorted((root / "dev").glob(pattern))
        ]
    for interface in sorted((root / "sys/class/net").glob("*")):
        if _text(interface / "type") == ARPHRD_CAN:
            state = _text(interface / "operstate")
            found.append(Place("can", interface.name, f"CAN interface, {state or 'unknown'}"))
    for chip in sorted((root / "sys/class/pwm").glob("pwmchip*")):
        channels = _text(chip / "npwm")
        found.append(Place("pwm", chip.name, f"PWM chip with {channels or '?'} channels"))
    return found


def place_of(name: str) -> Place:
    """Return the place that a person names: a device file, usb:SERIAL, a CAN interface (can0, or
    KIND:CHANNEL of another adapter), or pwmchipN."""
    if name.startswith("pwmchip"):
        return Place("pwm", name, "")
    if name.startswith(("/", "usb:", ".")):
        return Place("serial", name, "")
    return Place("can", name, "")


def can_address(name: str) -> str:
    """Return INTERFACE:CHANNEL of a CAN bus; a name alone is one of the kernel's interfaces."""
    return name if ":" in name else f"socketcan:{name}"


def interface_bit_rate(address: str) -> int | None:
    """Return the bits a second that the kernel's interface is set to; None: it does not report it,
    or there is no such interface."""
    interface, _, channel = address.partition(":")
    if interface != "socketcan":
        return None
    with contextlib.suppress(OSError):
        return bit_rate(channel)
    return None


def carries_fd(address: str, root: Path = Path("/")) -> bool:
    """Return whether frames of CAN FD can be sent there now."""
    interface, _, channel = address.partition(":")
    if interface == "socketcan":
        return _text(root / f"sys/class/net/{channel}/mtu") == CANFD_MTU
    return interface in ("unix", "virtual")


def _stable(root: Path, device: str) -> str:
    """Return the device's link in /dev/serial/by-id, otherwise the device file."""
    for link in sorted((root / "dev/serial/by-id").glob("*")):
        if link.resolve().name == Path(device).name:
            return f"/{link.relative_to(root)}"
    return device


def _text(path: Path) -> str:
    with contextlib.suppress(OSError):
        return path.read_text(encoding="ascii", errors="replace").strip()
    return ""
