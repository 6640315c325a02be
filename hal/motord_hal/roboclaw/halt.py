# SPDX-License-Identifier: Apache-2.0
"""Stopping RoboClaws that nobody talks to any more."""

from __future__ import annotations

from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.halt import halt_units
from motord_hal.modbus.timing import line_gap_s
from motord_hal.roboclaw.client import RoboclawClient


async def halt_line(spec: LineSpec) -> list[str]:
    """Returns what was not acknowledged, in words. Raises PortError."""
    return await halt_units(spec, RoboclawClient(spec, line_gap_s(spec), lambda _: True))
