# SPDX-License-Identifier: Apache-2.0
"""GPIO line that turns a transceiver."""

from __future__ import annotations

from pathlib import Path

from motord_hal.fieldbus.ports import DirectionSpec
from motord_hal.gpio.lines import Wanted, request_outputs


def request_line(spec: DirectionSpec, name: str, dev: Path = Path("/dev")) -> int:
    """Request the GPIO line of the line `name`, as an output at the level for receiving. The caller
    closes the descriptor. Raises PortError."""
    purpose, listening_high = f"line {name}, direction", not spec.active_high
    wanted = Wanted(line=spec.gpio_line, purpose=purpose, high=listening_high)
    return request_outputs(spec.gpio_chip, [wanted], f"motord {name}", dev)
