# SPDX-License-Identifier: Apache-2.0
"""A and B of an encoder on two GPIO lines: the kernel keeps each edge with its time.

Source: kernel, include/uapi/linux/gpio.h (v2) and Documentation/userspace-api/gpio/chardev.rst.
"""

from __future__ import annotations

import os
from pathlib import Path

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import EdgesEncoder
from motord_hal.gpio.chip import why
from motord_hal.gpio.lines import Pull, Wanted, levels_of, request_all_edges
from motord_hal.realtime.pwm import EncoderConfig, EncoderKind

EVENTS_KEPT = 1024
"""The kernel's most for 64 lines: 5 ms between two looks at 200,000 edges a second."""
PULLS = {"none": Pull.AS_IT_IS, "up": Pull.UP, "down": Pull.DOWN}


def open_edges(
    encoder: EdgesEncoder, joint: str, consumer: str, dev: Path = Path("/dev")
) -> EncoderConfig:
    """The descriptor in it is the caller's to close. Raises PortError."""
    wanted = [
        Wanted(line=line, purpose=f"joint {joint}, encoder {channel}")
        for channel, line in (("a", encoder.a), ("b", encoder.b))
    ]
    fd, offsets = request_all_edges(
        encoder.gpio_chip, wanted, consumer, PULLS[encoder.pull], EVENTS_KEPT, dev
    )
    try:
        a, b = levels_of(fd, len(wanted))
        os.set_blocking(fd, False)
    except OSError as error:
        os.close(fd)
        raise PortError(f"joint {joint}, encoder: {encoder.gpio_chip}: {why(error)}") from error
    return EncoderConfig(
        kind=EncoderKind.EDGES,
        fd=fd,
        a_offset=offsets[0],
        b_offset=offsets[1],
        levels=2 * a + b,
        rad_per_count=encoder.rad_per_count,
    )
