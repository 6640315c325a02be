# SPDX-License-Identifier: Apache-2.0
"""[battery]: how it is measured, and when it is low."""

from __future__ import annotations

from types import MappingProxyType
from typing import Annotated, Literal

from motord.config.sections.section import Field, Section, number

READING_UNITS = MappingProxyType(
    {"voltage_from": "V", "current_from": "A", "temperature_from": "°C"}
)
"""Keys that name a register, and the SI unit that it must have."""


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
    silent_s: float = number("unknown when nothing was measured for this long", 0.5, 600, "s", 5.0)
    cells: int | None = number("cells in series, where motord is to publish it", 1, 200, "1", None)
    capacity_ah: float | None = number("what it holds when it is new", 0.01, 10000, "Ah", None)


Reading = Annotated[str, Field(pattern=r"^[^.\s]+\.[^.\s]+$")]
"""JOINT.REGISTER: a register of a joint's drive by its profile's name."""


class DrivesBattery(Battery):
    """The lowest supply voltage among the drives that respond, and what their registers, or fields
    of a board, report about the pack itself."""

    source: Literal["drives"]
    joints: tuple[str, ...] = Field(default=(), strict=False)
    """Joints whose drives are read; none: all that measure a voltage."""
    voltage_from: Reading | None = None
    """The register that measures the pack's voltage, instead of the lowest supply voltage."""
    current_from: Reading | None = None
    """The register that measures the pack's current, as left.battery_current; none: not known."""
    temperature_from: Reading | None = None
    """The register that measures the pack's temperature; none: not known."""
    inverted: bool = False
    """The register of current_from is negative while the battery is discharged."""

    @property
    def readings(self) -> dict[str, str]:
        """The readings that are given, by key."""
        given = {key: getattr(self, key) for key in READING_UNITS}
        return {key: where for key, where in given.items() if where is not None}


class InaBattery(Battery):
    """A power monitor of Texas Instruments on an I2C bus, with its IN+ at the battery."""

    source: Literal["ina219", "ina226", "ina228", "ina238"]
    bus: str
    """Device file, as /dev/i2c-1."""
    address: int = number(
        "on the I2C bus, 0x40 to 0x4f by the pins A0 and A1", 0x40, 0x4F, "1", 0x40
    )
    shunt_ohm: float = number("resistance between IN+ and IN-", 1e-5, 10, "Ω", 0.1)
    inverted: bool = False
    """Whether IN- is at the battery, and not IN+."""
    chip_at_pack: bool = False
    """Whether the chip (ina228, ina238) is as warm as the pack: then its temperature is the
    battery's."""
