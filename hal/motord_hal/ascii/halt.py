# SPDX-License-Identifier: Apache-2.0
"""Stopping a board that reads text and after its program has ended."""

from __future__ import annotations

from motord_hal.ascii.dialect import TextDialect
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.mcu.halt import halt_board


async def halt_line(spec: LineSpec) -> list[str]:
    """Returns what was not acknowledged, in words. Raises PortError."""
    return await halt_board(spec, TextDialect(spec))
