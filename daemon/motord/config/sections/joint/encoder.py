# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.encoder]: encoder of a wheel whose drive does not count its turns."""

from __future__ import annotations

from typing import Annotated, Literal

from motord.config.sections.section import Field, Section, number


class Encoder(Section):
    """A quadrature encoder."""

    counts_per_turn: int = number(
        "edges of both channels for a motor turn: four times the pulses of one channel",
        1,
        1 << 30,
        "1",
    )
    reversed: bool = False
    """It counts backward when its motor turns forward: A and B are swapped."""


class GpioEncoder(Encoder):
    """An encoder on two GPIO lines: each edge is an interrupt."""

    kind: Literal["gpio"]
    a: str = Field(min_length=1)
    """GPIO line of channel A, by name or number."""
    b: str = Field(min_length=1)
    """GPIO line of channel B."""
    gpio_chip: str | None = None
    """Label or device file of the GPIO chip; by default the line's chip."""
    pull: Literal["none", "up", "down"] = "none"
    """Pull resistors of the chip on both lines: encoders with open collectors need "up"."""


class KernelEncoder(Encoder):
    """An encoder on a counter of the kernel: hardware decodes it."""

    kind: Literal["counter"]
    counter: str = Field(min_length=1)
    """Name of the counter, part of its device's path, or counterN: see /sys/bus/counter/devices."""
    count: int = number("which count of it", 0, 63, "1", 0)


class BoardEncoder(Encoder):
    """An encoder on your own board (docs/mcu-frame.md) that only counts; one board may have
    several."""

    kind: Literal["mcu"]
    port: str = Field(min_length=1)
    """Device file (/dev/serial/by-id/...), or usb:SERIAL for the board with that serial number."""
    baudrate: int = number("bits a second on the wire", 1200, 4_000_000, "1/s", 115200)
    motor: int = number("which motor of the board, as its sketch numbers them", 1, 4, "1")


AnyEncoder = Annotated[GpioEncoder | KernelEncoder | BoardEncoder, Field(discriminator="kind")]
