# SPDX-License-Identifier: Apache-2.0
"""Signals A and B of an encoder on two GPIO lines. The kernel keeps each edge with its time.

Source: kernel, include/uapi/linux/gpio.h (v2) and Documentation/userspace-api/gpio/chardev.rst.
"""

from __future__ import annotations

import os
from pathlib import Path

from gpiod.line import Bias

from motord_hal.fieldbus.ports import EdgesEncoder
from motord_hal.gpio.lines import Wanted, request_all_edges
from motord_hal.realtime.pwm import EncoderConfig, EncoderKind

EVENTS_KEPT = 1024
"""The kernel's maximum for 64 lines: 5 ms between two looks at 200,000 edges a second."""
PULLS = {"none": Bias.AS_IS, "up": Bias.PULL_UP, "down": Bias.PULL_DOWN}


def open_edges(
    encoder: EdgesEncoder, joint: str, consumer: str, dev: Path = Path("/dev")
) -> EncoderConfig:
    """Request the lines. The caller closes the descriptor in the result. Raises PortError."""
    wanted = [
        Wanted(line=line, purpose=f"joint {joint}, encoder {channel}")
        for channel, line in (("a", encoder.a), ("b", encoder.b))
    ]
    request = request_all_edges(
        encoder.gpio_chip, wanted, consumer, PULLS[encoder.pull], EVENTS_KEPT, dev
    )
    os.set_blocking(request.fd, False)
    (a_offset, b_offset), (a, b) = request.offsets, request.levels
    return EncoderConfig(
        kind=EncoderKind.EDGES,
        fd=request.fd,
        a_offset=a_offset,
        b_offset=b_offset,
        levels=2 * a + b,
        rad_per_count=encoder.rad_per_count,
    )
