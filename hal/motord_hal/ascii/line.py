# SPDX-License-Identifier: Apache-2.0
"""A board that reads text: the stream line of motord_hal.mcu with another dialect."""

from __future__ import annotations

from motord_hal.ascii.dialect import TextDialect
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.mcu.dialect import Dialect
from motord_hal.mcu.line import McuLine


class AsciiLine(McuLine):
    """ports.Line for `kind = "ascii"`, engine "asyncio". A board without feedback is taken to be
    there as long as its port is."""

    def _new_dialect(self, spec: LineSpec) -> Dialect:
        return TextDialect(spec)
