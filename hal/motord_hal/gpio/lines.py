# SPDX-License-Identifier: Apache-2.0
"""Requests for several lines of one GPIO chip at once, so that one call sets them all."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gpiod import LineSettings
from gpiod.line import Bias, Direction, Edge, Value

from motord_hal.base.errors import PortError
from motord_hal.gpio.chip import LINES_MAX, Chip, Request, open_chip, why
from motord_hal.gpio.pinmux import freeing_step, mux_owner, why_no_pull


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A line to request, and its purpose."""

    line: str
    """Name, or number on the chip."""
    purpose: str
    """Purpose in words for error messages, such as "joint left, pin in1"."""
    high: bool = False
    """For outputs: the first level."""


def request_outputs(
    chip: str, wanted: Sequence[Wanted], consumer: str, dev: Path = Path("/dev")
) -> int:
    """Request outputs; bit i of the request is `wanted[i]`. The caller closes the descriptor; it
    depends on the chip whether the lines then keep their levels. Raises PortError."""
    settings = [
        LineSettings(
            direction=Direction.OUTPUT, output_value=Value.ACTIVE if line.high else Value.INACTIVE
        )
        for line in wanted
    ]
    return _request(chip, wanted, settings, consumer, dev).fd


def request_inputs(
    chip: str, wanted: Sequence[Wanted], consumer: str, dev: Path = Path("/dev")
) -> int:
    """Request inputs, as `request_outputs` does for outputs."""
    settings = [LineSettings(direction=Direction.INPUT) for _ in wanted]
    return _request(chip, wanted, settings, consumer, dev).fd


def request_edges(
    chip: str,
    wanted: Wanted,
    consumer: str,
    pull: Bias,
    *,
    rising: bool,
    dev: Path = Path("/dev"),
) -> int:
    """Request one input, whose rising or falling edges the kernel keeps to be read. With both, the
    kernel would report an edge by the level that it finds afterwards. Otherwise as
    `request_inputs`."""
    edge = Edge.RISING if rising else Edge.FALLING
    return _request(chip, [wanted], [_edges(edge, pull)], consumer, dev).fd


def request_all_edges(
    chip: str,
    wanted: Sequence[Wanted],
    consumer: str,
    pull: Bias,
    events: int,
    dev: Path = Path("/dev"),
) -> Request:
    """Request inputs with the edges of all lines in both directions, of which the kernel keeps at
    least `events`. An edge names its line by the number on the chip. Otherwise as
    `request_inputs`."""
    settings = [_edges(Edge.BOTH, pull) for _ in wanted]
    return _request(chip, wanted, settings, consumer, dev, events)


def _edges(edge: Edge, pull: Bias) -> LineSettings:
    return LineSettings(direction=Direction.INPUT, edge_detection=edge, bias=pull)


def _request(
    chip: str,
    wanted: Sequence[Wanted],
    settings: Sequence[LineSettings],
    consumer: str,
    dev: Path,
    events: int = 0,
) -> Request:
    if len(wanted) > LINES_MAX:
        raise PortError(f"{len(wanted)} GPIO lines, at most {LINES_MAX}")
    with open_chip(chip, dev) as opened:
        for line, setting in zip(wanted, settings, strict=True):
            check_pull(opened.label, line, setting.bias)
        offsets = [_offset(opened, line) for line in wanted]
        _check_twice(offsets, wanted)
        try:
            return opened.request(offsets, settings, consumer, events)
        except OSError as error:
            raise PortError(_refusal(opened, wanted, offsets, error)) from error


def check_pull(label: str, line: Wanted, pull: Bias) -> None:
    """Raise PortError if the chip ignores this pull."""
    if pull in (Bias.PULL_UP, Bias.PULL_DOWN) and (problem := why_no_pull(label)):
        raise PortError(f"{line.purpose}: {problem}")


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
                remedy = f"end it, or free the pin: {freeing_step(owner)}"
                return f'{line.purpose}: {where} is in use by "{owner}": {remedy}'
    names = ", ".join(line.line for line in wanted)
    return f'{chip.path} "{chip.label}", lines {names}: {why(error)}'


def _name_and_owner(chip: Chip, offset: int) -> tuple[str, str]:
    """Return the owner of the line, else of its pin; "" if the chip does not report it."""
    try:
        name, owner = chip.info(offset)
    except OSError:
        return "", ""
    return name, owner or mux_owner(chip.label, offset)
