# SPDX-License-Identifier: Apache-2.0
"""How often a wire can carry one exchange with every drive on it: frame arithmetic."""

from __future__ import annotations

from motord_hal.modbus.codec import frame_time_s
from motord_hal.modbus.plan import DrivePlan
from motord_hal.modbus.timing import line_gap_s
from motord_hal.ports import LineSpec


def cycle_limit_hz(spec: LineSpec) -> float:
    """Highest cyclic rate of a Modbus RTU line whose drives answer at once."""

    def wire_time_s(size_bytes: int) -> float:
        return frame_time_s(size_bytes, spec.baudrate, spec.parity, spec.stop_bits)

    gap_s = line_gap_s(spec)
    total_s = 0.0
    for unit in {joint.unit for joint in spec.joints}:
        joints = {joint.channel: joint for joint in spec.joints if joint.unit == unit}
        total_s += DrivePlan(joints.values(), gap_s, wire_time_s).cycle_time_s()
    return 1 / total_s
