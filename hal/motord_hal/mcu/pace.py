# SPDX-License-Identifier: Apache-2.0
"""Rate of frames on a stream line: the robot file's rate, limited by the wire."""

from __future__ import annotations

from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.codec import frame_time_s

WIRE_SHARE_MAX = 0.9
"""Usable share of the wire. Clocks of both ends differ: on a full wire, ever more frames would
queue."""


def wire_limit_hz(spec: LineSpec, wire_bytes: int) -> float:
    """Return frames a second. Set-points and feedback have a wire each; the longer one counts."""
    return 1.0 / frame_time_s(wire_bytes, spec.baudrate, spec.parity, spec.stop_bits)


def period_s(spec: LineSpec, wire_bytes: int) -> float:
    return 1.0 / min(spec.cycle_hz, WIRE_SHARE_MAX * wire_limit_hz(spec, wire_bytes))
