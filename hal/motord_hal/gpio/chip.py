# SPDX-License-Identifier: Apache-2.0
"""Finds a GPIO chip by its label and a line by its name, and requests lines, by libgpiod."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import gpiod
from gpiod import LineSettings
from gpiod.line import Value

from motord_hal.base.errors import PortError

LINES_MAX = 64
"""Limit for one request: kernel, include/uapi/linux/gpio.h, GPIO_V2_LINES_MAX."""


@dataclass(frozen=True, slots=True)
class Request:
    """Requested lines. This process holds them until the owner closes the descriptor."""

    fd: int
    offsets: tuple[int, ...]
    """The lines' numbers on the chip."""
    levels: tuple[int, ...]
    """Level of each line at the time of the request, 0 or 1."""


@dataclass(frozen=True, slots=True)
class Chip:
    """An open GPIO chip."""

    gpio: gpiod.Chip
    path: Path
    label: str
    lines: int

    def find(self, wanted: str) -> int:
        """Return the offset of a line by name or number. Raises OSError, and LookupError if no line
        or more than one has the name."""
        if wanted.isdecimal():
            if int(wanted) >= self.lines:
                raise LookupError(f"no GPIO line {wanted} (0 to {self.lines - 1})")
            return int(wanted)
        return _only_line([self.info(offset)[0] for offset in range(self.lines)], wanted)

    def info(self, offset: int) -> tuple[str, str]:
        """Return a line's name, and its user; "" where either is missing. Raises OSError."""
        info = self.gpio.get_line_info(offset)
        return info.name, (info.consumer or "the kernel") if info.used else ""

    def request(
        self,
        offsets: Sequence[int],
        settings: Sequence[LineSettings],
        consumer: str,
        events: int = 0,
    ) -> Request:
        """Request lines, in this order. `events` is the least number of them that the kernel keeps;
        0: its default. Raises OSError."""
        config: dict[Iterable[int | str] | int | str, LineSettings | None] = {}
        config.update(zip(offsets, settings, strict=True))
        with self.gpio.request_lines(config, consumer, events or None) as request:
            levels = tuple(int(value is Value.ACTIVE) for value in request.get_values())
            # the C thread's descriptor outlives the library's object
            return Request(os.dup(request.fd), tuple(offsets), levels)


def _only_line(names: Sequence[str], wanted: str) -> int:
    found = [offset for offset, name in enumerate(names) if name == wanted]
    if not found:
        raise LookupError(f'no GPIO line "{wanted}" on this chip')
    if len(found) > 1:
        numbers = ", ".join(map(str, found))
        raise LookupError(f'lines {numbers} of this chip have the name "{wanted}": give a number')
    return found[0]


@contextmanager
def open_chip(wanted: str, dev: Path = Path("/dev")) -> Iterator[Chip]:
    """Open the chip with that label, or that device file. Raises PortError, also if several chips
    have the label."""
    path = _path_of(wanted, dev)
    try:
        chip = gpiod.Chip(str(path))
    except OSError as error:
        raise PortError(f"GPIO chip {path} cannot be opened: {why(error)}") from error
    with chip:
        info = chip.get_info()
        yield Chip(chip, path, info.label, info.num_lines)


def _path_of(wanted: str, dev: Path) -> Path:
    if wanted.startswith(("/", "gpiochip")):
        return dev / wanted
    labels: dict[Path, str] = {}
    refused = []
    for path in sorted(dev.glob("gpiochip*")):
        try:
            with gpiod.Chip(str(path)) as chip:
                labels[path] = chip.get_info().label
        except OSError as error:
            refused.append(f"{path.name} ({why(error)})")
    return _only_chip(labels, wanted, refused)


def _only_chip(labels: dict[Path, str], wanted: str, refused: Sequence[str] = ()) -> Path:
    found = [path for path, label in labels.items() if label == wanted]
    if not found:
        seen = [f'{path.name} "{label}"' for path, label in labels.items()]
        raise PortError(f'no GPIO chip "{wanted}"; there: {", ".join([*seen, *refused]) or "none"}')
    if len(found) > 1:
        paths = ", ".join(map(str, found))
        text = f'{len(found)} GPIO chips have the label "{wanted}": {paths}'
        raise PortError(f"{text}: name one by its device file (a udev rule keeps its name)")
    return found[0]


def why(error: OSError) -> str:
    """Return the error in words, with a remedy."""
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{error.strerror}: put this user into the group gpio, or see the udev rules"
    return error.strerror or str(error)
