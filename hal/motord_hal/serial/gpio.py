# SPDX-License-Identifier: Apache-2.0
"""The GPIO line that turns a transceiver."""

from __future__ import annotations

import os
from pathlib import Path

from motord_hal.errors import PortError
from motord_hal.gpio.chip import open_chip
from motord_hal.ports import DirectionSpec


def request_line(spec: DirectionSpec, name: str, dev: Path = Path("/dev")) -> int:
    """The descriptor of the line `name`'s GPIO line, an output at the level of listening: the
    caller closes it. Raises PortError."""
    chip = open_chip(spec.gpio_chip, dev)
    try:
        offset = chip.find(spec.gpio_line)
        return chip.request([offset], f"motord {name}", 0 if spec.active_high else 1)
    except (OSError, LookupError) as error:
        what = error.strerror if isinstance(error, OSError) else error
        raise PortError(f"{spec.gpio_chip} {spec.gpio_line}: {what}") from error
    finally:
        os.close(chip.fd)
