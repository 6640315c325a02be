# SPDX-License-Identifier: Apache-2.0
"""The present device file of an adapter, and the program that holds it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from motord_hal.base.errors import PortError

if TYPE_CHECKING:
    from serial.tools.list_ports_common import ListPortInfo

USB_PREFIX = "usb:"
_PROC = Path("/proc")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def usb_ports() -> list[ListPortInfo]:
    """Return the serial ports of all USB adapters that are plugged in."""
    # imported only here: lines whose port is a path need no pyserial
    from serial.tools.list_ports import comports

    try:
        return [port for port in comports() if port.vid is not None]
    except TypeError:  # int(None) in pyserial: an adapter was unplugged while it was read
        return []


def device_file(port: str) -> str:
    """Return the device file that `port` (a path, or usb:SERIAL) means now. Raises PortError."""
    if not port.startswith(USB_PREFIX):
        return port
    serial = port.removeprefix(USB_PREFIX)
    known = usb_ports()
    fitting = [each for each in known if serial and each.serial_number == serial]
    if len(fitting) == 1:
        return str(fitting[0].device)
    if fitting:
        names = ", ".join(each.name for each in fitting)
        raise PortError(
            f"{port} is not one port but {len(fitting)} ({names}): name a path of /dev/serial/by-id"
        )
    there = ", ".join(
        f'{one.name} is "{one.serial_number or ""}" ({one.vid:04x}:{one.pid:04x})' for one in known
    )
    raise PortError(f"{port}: no such USB adapter is plugged in; there: {there or 'none'}")


def port_identity(port: str) -> str:
    """Return one name for all names that a port has on this machine now: links, and usb:SERIAL. An
    absent adapter, and what is no device file, keeps its name."""
    try:
        path = device_file(port)
    except PortError:
        return port
    return os.path.realpath(path) if path.startswith("/") else path


def holders(path: str, proc: Path = _PROC) -> tuple[str, ...]:
    """Return the other programs that have the file open, as "program (pid N)", as far as
    permissions allow."""
    real = os.path.realpath(path)
    found = []
    for process in proc.glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            links = {os.readlink(entry) for entry in (process / "fd").iterdir()}
        except OSError:
            continue  # no permission, or it has just ended
        if real in links:
            found.append(f"{_text(process / 'comm')} (pid {process.name})")
    return tuple(sorted(found))
