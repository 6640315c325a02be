# SPDX-License-Identifier: Apache-2.0
"""How often frames go over a stream line: as the robot file says, and no more than its wire."""

from __future__ import annotations

from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.codec import frame_time_s

WIRE_SHARE_MAX = 0.9
"""The clocks of both ends differ: a wire that is full would fall behind more and more."""


def wire_limit_hz(spec: LineSpec, wire_bytes: int) -> float:
    """Frames a second; set-points and feedback have a wire each, the longer one counts."""
    return 1.0 / frame_time_s(wire_bytes, spec.baudrate, spec.parity, spec.stop_bits)


def period_s(spec: LineSpec, wire_bytes: int) -> float:
    return 1.0 / min(spec.cycle_hz, WIRE_SHARE_MAX * wire_limit_hz(spec, wire_bytes))
