# SPDX-License-Identifier: Apache-2.0
"""Which device file an adapter has now, and who holds it: facts read from /sys and /proc."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from motord_hal.base.errors import PortError

USB_PREFIX = "usb:"
_SYS = Path("/sys")
_PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class UsbPort:
    """One tty of a USB adapter."""

    tty: str
    serial: str
    vendor_product: str
    """As lsusb prints it: 0403:6001."""


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def usb_ports(sys: Path = _SYS) -> tuple[UsbPort, ...]:
    """All ttys that hang on a USB device, by name."""
    found = []
    for tty in sorted((sys / "class" / "tty").glob("*")):
        device = tty / "device"
        if not device.exists():
            continue
        for above in (real := device.resolve(), *real.parents):
            vendor = _text(above / "idVendor")
            if vendor:
                number = f"{vendor}:{_text(above / 'idProduct')}"
                found.append(UsbPort(tty.name, _text(above / "serial"), number))
                break
    return tuple(found)


def device_file(port: str, sys: Path = _SYS, dev: Path = Path("/dev")) -> str:
    """The device file that `port` (a path, or usb:SERIAL) means now. Raises PortError."""
    if not port.startswith(USB_PREFIX):
        return port
    serial = port.removeprefix(USB_PREFIX)
    known = usb_ports(sys)
    fitting = [each for each in known if serial and each.serial == serial]
    if len(fitting) == 1:
        return str(dev / fitting[0].tty)
    if fitting:
        names = ", ".join(each.tty for each in fitting)
        raise PortError(
            f"{port} is not one port but {len(fitting)} ({names}): name a path of /dev/serial/by-id"
        )
    there = ", ".join(f'{p.tty} is "{p.serial}" ({p.vendor_product})' for p in known) or "none"
    raise PortError(f"{port}: no such USB adapter is plugged in; there: {there}")


def holders(path: str, proc: Path = _PROC) -> tuple[str, ...]:
    """Who else has the file open, as "program (pid N)": as far as we are permitted to see."""
    real = os.path.realpath(path)
    found = []
    for process in proc.glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            links = {os.readlink(entry) for entry in (process / "fd").iterdir()}
        except OSError:
            continue  # not ours to see, or it has just ended
        if real in links:
            found.append(f"{_text(process / 'comm')} (pid {process.name})")
    return tuple(sorted(found))
