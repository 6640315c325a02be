# SPDX-License-Identifier: Apache-2.0
"""Taking the power from bridges whose program has ended."""

from __future__ import annotations

from motord_hal.fieldbus.ports import LineSpec
from motord_hal.pwm.pins import rest_pins


async def halt_line(spec: LineSpec) -> list[str]:
    """Returns what was not done, in words."""
    return await rest_pins(spec)
