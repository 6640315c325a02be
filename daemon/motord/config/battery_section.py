# SPDX-License-Identifier: Apache-2.0
"""[battery]: who measures it, and when it is low."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from motord.config.section import Section, number


class Battery(Section):
    """The pack as a whole; thresholds are the voltage between its ends."""

    low_v: float = number("below this: a warning", 1, 1000, "V")
    critical_v: float = number("below this: critical", 1, 1000, "V")
    hysteresis_v: float = number(
        "by how much the voltage must rise above a threshold before it counts as above it",
        0.0,
        100,
        "V",
        0.5,
    )
    settle_s: float = number(
        "how long a threshold must be passed before it counts: motors pull the voltage down for "
        "moments",
        0.0,
        600,
        "s",
        3.0,
    )
    silent_s: float = number("unknown when nothing was measured for so long", 0.5, 600, "s", 5.0)
    cells: int | None = number("cells in series, where motord is to publish it", 1, 200, "1", None)
    capacity_ah: float | None = number("what it holds when it is new", 0.01, 10000, "Ah", None)


class DrivesBattery(Battery):
    """The supply voltage that the drives measure: the lowest one of those that are heard."""

    source: Literal["drives"]
    joints: tuple[str, ...] = Field(default=(), strict=False)
    """Whose drives; none: all that measure a voltage."""


class InaBattery(Battery):
    """A power monitor of Texas Instruments on an I2C bus, its IN+ at the battery."""

    source: Literal["ina219", "ina226"]
    bus: str
    """Device file, as /dev/i2c-1."""
    address: int = number("on the bus, 0x40 to 0x4f by the pins A0 and A1", 0x40, 0x4F, "1", 0x40)
    shunt_ohm: float = number("resistance between IN+ and IN-", 1e-5, 10, "Ω", 0.1)
    inverted: bool = False
    """IN- is at the battery."""
