# SPDX-License-Identifier: Apache-2.0
"""What drives may be connected to on this machine: serial ports, CAN interfaces, PWM chips."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from motord_hal.serial.sysfs import usb_ports

ARPHRD_CAN = "280"
"""Linux: include/uapi/linux/if_arp.h."""
BOARD_PORTS = ("ttyAMA*", "ttyTHS*", "ttymxc*", "serial[0-9]*")
"""UARTs on the pins of a board; ttyS of a PC are mostly not there."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a line can be opened."""

    kind: Literal["serial", "can", "pwm"]
    name: str
    """As the robot file takes it."""
    about: str


def places(root: Path = Path("/")) -> list[Place]:
    """All of them; the same names after the next boot, where there are such."""
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
    """One that a person names: a device file, usb:SERIAL, a CAN interface or pwmchipN."""
    if name.startswith("pwmchip"):
        return Place("pwm", name, "")
    if name.startswith(("/", "usb:", ".")):
        return Place("serial", name, "")
    return Place("can", name, "")


def _stable(root: Path, device: str) -> str:
    """Its link in /dev/serial/by-id, else the device file."""
    for link in sorted((root / "dev/serial/by-id").glob("*")):
        if link.resolve().name == Path(device).name:
            return f"/{link.relative_to(root)}"
    return device


def _text(path: Path) -> str:
    with contextlib.suppress(OSError):
        return path.read_text(encoding="ascii", errors="replace").strip()
    return ""
