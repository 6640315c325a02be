# SPDX-License-Identifier: Apache-2.0
"""A counter of the kernel that decodes an encoder in hardware: it is found by its device, set to
count all edges, and its `count` file opened.

Source: kernel, Documentation/ABI/testing/sysfs-bus-counter and
Documentation/driver-api/generic-counter.rst.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import CounterEncoder
from motord_hal.realtime.pwm import EncoderConfig, EncoderKind

DEVICES = Path("/sys/bus/counter/devices")
FUNCTION = "quadrature x4"
WIDEST = (1 << 64) - 1


def find_counter(wanted: str, root: Path = DEVICES) -> Path:
    """Return a counter by its name, a part of its device's path (the numbers change from boot to
    boot), counterN, or a folder's whole path. Raises PortError."""
    if wanted.startswith("/"):
        return Path(wanted)
    devices = {path.name: path.resolve() for path in sorted(root.glob("counter*"))}
    if wanted in devices:
        return devices[wanted]
    names = {number: _read(path / "name") for number, path in devices.items()}
    found = [
        path
        for number, path in devices.items()
        if wanted == names[number] or wanted in str(path.parent)
    ]
    if len(found) == 1:
        return found[0]
    there = ", ".join(f'{number} "{name}"' for number, name in names.items())
    what = f"{len(found)} counters fit" if found else "no counter"
    hint = "" if found else ". The board's device tree must give its pins to a counter"
    raise PortError(f'{what} "{wanted}"; there: {there or "none"}{hint}')


def open_counter(encoder: CounterEncoder, joint: str, root: Path = DEVICES) -> EncoderConfig:
    """Open the counter. The caller closes the descriptor in the result. Raises PortError."""
    folder = find_counter(encoder.counter, root) / f"count{encoder.count}"
    where = f"joint {joint}, encoder {folder}"
    if not folder.is_dir():
        raise PortError(f"{where}: there is no such count")
    try:
        _set(folder / "function", FUNCTION, where)
        if (folder / "enable").exists():
            _set(folder / "enable", "1", where)
        ceiling = _ceiling(folder)
        if ceiling == 0:
            raise PortError(f"{where}: its ceiling is 0, so it never counts: write a greater one")
        fd = os.open(folder / "count", os.O_RDONLY | os.O_CLOEXEC)
    except OSError as error:
        raise PortError(f"{where}: {_why(error)}") from error
    return EncoderConfig(
        kind=EncoderKind.COUNTER,
        fd=fd,
        ceiling=ceiling,
        rad_per_count=encoder.rad_per_count,
    )


def _set(file: Path, value: str, where: str) -> None:
    """Write a value only if it differs, and read it back. Raises OSError, PortError."""
    if _read(file) == value:
        return
    file.write_text(f"{value}\n")
    if (found := _read(file)) != value:
        raise PortError(f'{where}: {file.name} is "{found}", and cannot be set to "{value}"')


def _ceiling(folder: Path) -> int:
    """Return the count before it wraps to 0; the widest possible if it is not reported."""
    text = _read(folder / "ceiling")
    return min(int(text), WIDEST) if text.isdecimal() else WIDEST


def _read(file: Path) -> str:
    try:
        return file.read_text(errors="replace").strip()
    except OSError:
        return ""


def _why(error: OSError) -> str:
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{error.strerror}: see the udev rules"
    return error.strerror or str(error)
