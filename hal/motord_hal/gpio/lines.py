# SPDX-License-Identifier: Apache-2.0
"""Several lines of one chip in one request, so that one call sets them all at once."""

from __future__ import annotations

import enum
import errno
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from motord_hal.base.errors import PortError
from motord_hal.gpio.chip import (
    FLAG_FALLING,
    FLAG_PULL_DOWN,
    FLAG_PULL_UP,
    FLAG_RISING,
    LINES_MAX,
    Chip,
    open_chip,
    read_levels,
    why,
)
from motord_hal.gpio.pinmux import freeing_step, mux_owner


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A line of the request, and what it is for."""

    line: str
    """Name, or number on the chip."""
    purpose: str
    """For the error's sentence, as "joint left, pin in1"."""
    high: bool = False
    """Outputs: the level to begin with."""


class Pull(enum.IntEnum):
    """What the chip does to an input that nobody drives."""

    AS_IT_IS = 0
    UP = FLAG_PULL_UP
    DOWN = FLAG_PULL_DOWN


_WITHOUT_PULLS = "tegra"
"""How the labels of the chips of all Jetsons begin. Their driver knows no bias, and the kernel
takes that for no error: gpio_set_bias of drivers/gpio/gpiolib.c, tegra186_gpio_set_config."""


def why_no_pull(label: str) -> str:
    """Why a line of that chip cannot be pulled, and what to do; empty where nothing is known
    against it."""
    if not label.startswith(_WITHOUT_PULLS):
        return ""
    return (
        f'the chip "{label}" has no pulls that Linux can switch on, and Linux does not say so: an '
        "open line would float, and an open contact be no stop. Put a resistor outside (pull up: "
        'from the line to 3.3 V; down: to ground), and say pull = false (of an encoder: "none")'
    )


def request_outputs(
    chip: str, wanted: Sequence[Wanted], consumer: str, dev: Path = Path("/dev")
) -> int:
    """Bit i of the request is `wanted[i]`. The caller closes the descriptor: the lines then keep
    their levels, or not, as the chip likes. Raises PortError."""
    levels = sum(1 << place for place, line in enumerate(wanted) if line.high)
    return _request(chip, wanted, consumer, levels, dev)[0]


def request_inputs(
    chip: str, wanted: Sequence[Wanted], consumer: str, dev: Path = Path("/dev")
) -> int:
    """As `request_outputs`."""
    return _request(chip, wanted, consumer, None, dev)[0]


def request_edges(
    chip: str,
    wanted: Wanted,
    consumer: str,
    pull: Pull,
    *,
    rising: bool,
    dev: Path = Path("/dev"),
) -> int:
    """As `request_inputs`, for one input that also keeps its edges to be read: the rising ones, or
    the falling ones. Of both the kernel says which it was by the level that it finds afterwards."""
    edge = FLAG_RISING if rising else FLAG_FALLING
    return _request(chip, [wanted], consumer, None, dev, edge | pull)[0]


def request_all_edges(
    chip: str,
    wanted: Sequence[Wanted],
    consumer: str,
    pull: Pull,
    events: int,
    dev: Path = Path("/dev"),
) -> tuple[int, list[int]]:
    """As `request_inputs`, with the edges of all lines, both ways, `events` of them at least; and
    the lines' numbers on the chip, by which events name them."""
    flags = FLAG_RISING | FLAG_FALLING | pull
    return _request(chip, wanted, consumer, None, dev, flags, events)


def levels_of(fd: int, lines: int) -> list[int]:
    """0 or 1 for each of a request's first lines. Raises OSError."""
    return read_levels(fd, lines)


def _request(
    chip: str,
    wanted: Sequence[Wanted],
    consumer: str,
    outputs: int | None,
    dev: Path,
    flags: int = 0,
    events: int = 0,
) -> tuple[int, list[int]]:
    if len(wanted) > LINES_MAX:
        raise PortError(f"{len(wanted)} GPIO lines, at most {LINES_MAX}")
    opened = open_chip(chip, dev)
    try:
        return _request_of(opened, wanted, consumer, outputs, flags, events)
    finally:
        os.close(opened.fd)


def _request_of(
    chip: Chip,
    wanted: Sequence[Wanted],
    consumer: str,
    outputs: int | None,
    flags: int = 0,
    events: int = 0,
) -> tuple[int, list[int]]:
    if flags & (Pull.UP | Pull.DOWN) and (problem := why_no_pull(chip.label)):
        raise PortError(f"{wanted[0].purpose}: {problem}")
    offsets = [_offset(chip, line) for line in wanted]
    _check_twice(offsets, wanted)
    try:
        return chip.request(offsets, consumer, outputs, flags, events), offsets
    except OSError as error:
        raise PortError(_refusal(chip, wanted, offsets, error)) from error


def _offset(chip: Chip, line: Wanted) -> int:
    try:
        return chip.find(line.line)
    except LookupError as error:
        text = f'{line.purpose}: {error.args[0]} ("{chip.label}", {chip.path})'
        raise PortError(text) from error
    except OSError as error:
        raise PortError(f"{line.purpose}: {chip.path}: {why(error)}") from error


def _check_twice(offsets: Sequence[int], wanted: Sequence[Wanted]) -> None:
    for place, offset in enumerate(offsets):
        if offset in offsets[:place]:
            other = wanted[offsets.index(offset)].purpose
            raise PortError(f"{wanted[place].purpose}: line {offset} is that of {other}")


def _refusal(chip: Chip, wanted: Sequence[Wanted], offsets: Sequence[int], error: OSError) -> str:
    if error.errno == errno.EBUSY:
        for line, offset in zip(wanted, offsets, strict=True):
            name, owner = _name_and_owner(chip, offset)
            if owner:
                where = f'line {offset} ("{name}") of {chip.path} "{chip.label}"'
                way = f"end it, or free the pin: {freeing_step(owner)}"
                return f'{line.purpose}: {where} is in use by "{owner}": {way}'
    names = ", ".join(line.line for line in wanted)
    return f'{chip.path} "{chip.label}", lines {names}: {why(error)}'


def _name_and_owner(chip: Chip, offset: int) -> tuple[str, str]:
    """The owner of the line, else of the pin that it is; empty where the chip does not say."""
    try:
        name, owner = chip.info(offset)
    except OSError:
        return "", ""
    return name, owner or mux_owner(chip.label, offset)
