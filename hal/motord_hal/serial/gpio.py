# SPDX-License-Identifier: Apache-2.0
"""A GPIO line for a transceiver, by the character device's own interface.

Source: kernel, include/uapi/linux/gpio.h (v2) and Documentation/userspace-api/gpio/chardev.rst.
"""

from __future__ import annotations

import fcntl
import os
import struct
from pathlib import Path

from motord_hal.errors import PortError
from motord_hal.ports import DirectionSpec

_GET_CHIP_INFO = 0x8044B401
_GET_LINE_INFO = 0xC100B405
_GET_LINE = 0xC250B407
_CHIP_INFO = struct.Struct("=32s32sI")
_LINE_INFO = struct.Struct("=32s32s2IQ176x")
_LINE_REQUEST = struct.Struct("=I252x32sQI20x2I2Q216x2I20xi")
"""One offset, consumer, flags, one attribute (id, padding, value, mask), lines, buffer, fd."""
_FLAG_OUTPUT = 8
_ATTRIBUTE_OUTPUT_VALUES = 2


def _name(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode(errors="replace")


def pack_line_request(offset: int, consumer: str, value: int) -> bytes:
    """struct gpio_v2_line_request: one output with its first value."""
    name = consumer.encode()[:31]
    attribute = (_ATTRIBUTE_OUTPUT_VALUES, 0, value, 1)
    return _LINE_REQUEST.pack(offset, name, _FLAG_OUTPUT, 1, *attribute, 1, 0, 0)


def _open_chip(path: Path) -> tuple[int, str, int]:
    """Descriptor, label, lines. Raises OSError."""
    fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    try:
        info = fcntl.ioctl(fd, _GET_CHIP_INFO, bytes(_CHIP_INFO.size))
    except OSError:
        os.close(fd)
        raise
    _, label, lines = _CHIP_INFO.unpack(info)
    return fd, _name(label), lines


def _find_chip(wanted: str, dev: Path) -> tuple[int, int]:
    """Descriptor and lines. Raises PortError."""
    if wanted.startswith(("/", "gpiochip")):
        path = Path(wanted) if wanted.startswith("/") else dev / wanted
        try:
            fd, _, lines = _open_chip(path)
        except OSError as error:
            raise PortError(f"GPIO chip {path} cannot be opened: {error.strerror}") from error
        return fd, lines
    seen = []
    for path in sorted(dev.glob("gpiochip*")):
        try:
            fd, label, lines = _open_chip(path)
        except OSError as error:
            seen.append(f"{path.name} ({error.strerror})")
            continue
        if label == wanted:
            return fd, lines
        os.close(fd)
        seen.append(f'{path.name} "{label}"')
    raise PortError(f'no GPIO chip "{wanted}"; there: {", ".join(seen) or "none"}')


def _find_line(fd: int, lines: int, wanted: str) -> int:
    """The line's number. Raises OSError, LookupError."""
    if wanted.isdecimal():
        if int(wanted) >= lines:
            raise LookupError(f"GPIO line {wanted} (0 to {lines - 1})")
        return int(wanted)
    for offset in range(lines):
        asked = _LINE_INFO.pack(b"", b"", offset, 0, 0)
        if _name(_LINE_INFO.unpack(fcntl.ioctl(fd, _GET_LINE_INFO, asked))[0]) == wanted:
            return offset
    raise LookupError(f'no GPIO line "{wanted}" on this chip')


def request_line(spec: DirectionSpec, name: str, dev: Path = Path("/dev")) -> int:
    """The descriptor of the line `name`'s GPIO line, an output at the level of listening: the
    caller closes it. Raises PortError."""
    chip_fd, lines = _find_chip(spec.gpio_chip, dev)
    try:
        offset = _find_line(chip_fd, lines, spec.gpio_line)
        asked = pack_line_request(offset, f"motord {name}", 0 if spec.active_high else 1)
        fd: int = _LINE_REQUEST.unpack(fcntl.ioctl(chip_fd, _GET_LINE, asked))[-1]
    except (OSError, LookupError) as error:
        what = error.strerror if isinstance(error, OSError) else error
        raise PortError(f"{spec.gpio_chip} {spec.gpio_line}: {what}") from error
    finally:
        os.close(chip_fd)
    return fd
