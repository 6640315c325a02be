# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.derating]: the base becomes slower before a drive stops it."""

from __future__ import annotations

from collections.abc import Mapping

from motord.config.sections.section import Section, number

PAIRS: Mapping[str, tuple[str, str]] = {
    "temperature": ("temperature_from_c", "temperature_to_c"),
    "current": ("current_from_a", "current_to_a"),
    "voltage": ("voltage_from_v", "voltage_to_v"),
}
"""Causes of derating in the core's order, with the keys where it begins and where nothing is
left."""


class Derating(Section):
    """Derating. From the first value of a pair to the second one, the speed limits of the base fall
    linearly to zero. The drive's reports are smoothed over a second."""

    temperature_from_c: float | None = number(
        "temperature at which it begins", -40, 300, "°C", None
    )
    temperature_to_c: float | None = number(
        "temperature at which the base stands", -40, 300, "°C", None
    )
    current_from_a: float | None = number("current at which it begins", 0, 10000, "A", None)
    current_to_a: float | None = number("current at which the base stands", 0, 10000, "A", None)
    voltage_from_v: float | None = number(
        "supply voltage at which it begins; it is above voltage_to_v", 0, 1000, "V", None
    )
    voltage_to_v: float | None = number(
        "supply voltage at which the base stands", 0, 1000, "V", None
    )
