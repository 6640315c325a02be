# SPDX-License-Identifier: Apache-2.0
"""Finds a GPIO chip by its label and a line by its name, and requests lines.

Source: kernel, include/uapi/linux/gpio.h (v2) and Documentation/userspace-api/gpio/chardev.rst.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from motord_hal.base.errors import PortError

LINES_MAX = 64
"""Of one request."""
_GET_CHIP_INFO = 0x8044B401
_GET_LINE_INFO = 0xC100B405
_GET_LINE = 0xC250B407
_GET_VALUES = 0xC010B40E
_CHIP_INFO = struct.Struct("=32s32sI")
_LINE_INFO = struct.Struct("=32s32s2IQ176x")
_LINE_VALUES = struct.Struct("=QQ")
_LINE_REQUEST = struct.Struct("=64I32sQI20xI4xQQ216x2I20xi")
"""Offsets, consumer, flags, attributes, the first of them (id, value, mask), lines, buffer, fd."""
_FLAG_USED = 1
_FLAG_INPUT = 4
_FLAG_OUTPUT = 8
FLAG_RISING, FLAG_FALLING = 16, 32
FLAG_PULL_UP = 256
FLAG_PULL_DOWN = 512
_ATTRIBUTE_OUTPUT_VALUES = 2


def _name(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode(errors="replace")


@dataclass(frozen=True, slots=True)
class Chip:
    """An open chip. The descriptor is the owner's to close."""

    fd: int
    path: Path
    label: str
    lines: int

    def find(self, wanted: str) -> int:
        """The offset of a line by name or number. Raises OSError, and LookupError for a name that
        no line has, or more than one."""
        if wanted.isdecimal():
            if int(wanted) >= self.lines:
                raise LookupError(f"no GPIO line {wanted} (0 to {self.lines - 1})")
            return int(wanted)
        return _only_line([self.info(offset)[0] for offset in range(self.lines)], wanted)

    def info(self, offset: int) -> tuple[str, str]:
        """A line's name, and who uses it: empty where nobody does. Raises OSError."""
        asked = _LINE_INFO.pack(b"", b"", offset, 0, 0)
        name, user, _, _, flags = _LINE_INFO.unpack(fcntl.ioctl(self.fd, _GET_LINE_INFO, asked))
        return _name(name), (_name(user) or "the kernel") if flags & _FLAG_USED else ""

    def request(
        self,
        offsets: Sequence[int],
        consumer: str,
        outputs: int | None,
        flags: int = 0,
        events: int = 0,
    ) -> int:
        """The descriptor of a request of these lines: inputs, or outputs that begin with the bits
        of `outputs` in the order of `offsets`. `flags`: FLAG_*. `events`: so many the kernel keeps
        at least; 0: as it likes. Raises OSError."""
        asked = pack_request(offsets, consumer, outputs, flags, events)
        fd: int = _LINE_REQUEST.unpack(fcntl.ioctl(self.fd, _GET_LINE, asked))[-1]
        return fd


def _only_line(names: Sequence[str], wanted: str) -> int:
    found = [offset for offset, name in enumerate(names) if name == wanted]
    if not found:
        raise LookupError(f'no GPIO line "{wanted}" on this chip')
    if len(found) > 1:
        numbers = ", ".join(map(str, found))
        raise LookupError(f'lines {numbers} of this chip are "{wanted}": name one by its number')
    return found[0]


def pack_request(
    offsets: Sequence[int],
    consumer: str,
    outputs: int | None,
    more_flags: int = 0,
    events: int = 0,
) -> bytes:
    """struct gpio_v2_line_request."""
    places = [*offsets, *[0] * (LINES_MAX - len(offsets))]
    name = consumer.encode()[:31]
    flags = more_flags | (_FLAG_INPUT if outputs is None else _FLAG_OUTPUT)
    values = (0, 0, 0, 0)
    if outputs is not None:
        values = (1, _ATTRIBUTE_OUTPUT_VALUES, outputs, (1 << len(offsets)) - 1)
    return _LINE_REQUEST.pack(*places, name, flags, *values, len(offsets), events, 0)


def read_levels(fd: int, lines: int) -> list[int]:
    """Of a request's lines, in its order. Raises OSError."""
    asked = _LINE_VALUES.pack(0, (1 << lines) - 1)
    bits, _ = _LINE_VALUES.unpack(fcntl.ioctl(fd, _GET_VALUES, asked))
    return [bits >> place & 1 for place in range(lines)]


def _open(path: Path) -> Chip:
    fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        info = fcntl.ioctl(fd, _GET_CHIP_INFO, bytes(_CHIP_INFO.size))
    except OSError:
        os.close(fd)
        raise
    _, label, lines = _CHIP_INFO.unpack(info)
    return Chip(fd, path, _name(label), lines)


def open_chip(wanted: str, dev: Path = Path("/dev")) -> Chip:
    """The chip with that label, or the device file. Raises PortError, also where several have that
    label."""
    if wanted.startswith(("/", "gpiochip")):
        path = Path(wanted) if wanted.startswith("/") else dev / wanted
        try:
            return _open(path)
        except OSError as error:
            raise PortError(f"GPIO chip {path} cannot be opened: {why(error)}") from error
    seen, found = [], []
    for path in sorted(dev.glob("gpiochip*")):
        try:
            chip = _open(path)
        except OSError as error:
            seen.append(f"{path.name} ({why(error)})")
            continue
        if chip.label == wanted:
            found.append(chip)
        else:
            os.close(chip.fd)
            seen.append(f'{path.name} "{chip.label}"')
    if not found:
        raise PortError(f'no GPIO chip "{wanted}"; there: {", ".join(seen) or "none"}')
    return _only_chip(found)


def _only_chip(found: Sequence[Chip]) -> Chip:
    """Closes them where they are more than one."""
    if len(found) > 1:
        for chip in found:
            os.close(chip.fd)
        paths = ", ".join(str(chip.path) for chip in found)
        text = f'{len(found)} GPIO chips are "{found[0].label}": {paths}'
        raise PortError(f"{text}: name one by its device file (a udev rule keeps its name)")
    return found[0]


def why(error: OSError) -> str:
    """In words, with what helps."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{error.strerror}: put this user into the group gpio, or see the udev rules"
    return error.strerror or str(error)
