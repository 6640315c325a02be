# SPDX-License-Identifier: Apache-2.0
"""Set-point frames for a board, made by Python."""

from motord_hal.mcu.frames import Frame, Type, build, setpoints_payload, wire_bytes
from motord_hal.mcu.pace import period_s

NS_PER_US = 1000


class FrameSender:
    """Makes the frames of one program, numbered in sequence."""

    def __init__(self, spec):
        profile = spec.joints[0].profile
        self._registers = tuple(profile.registers.values())
        self._motors = max(profile.channels)
        self._feedback_s = period_s(spec, wire_bytes(self._motors, imu=spec.imu is not None))
        self._sequence = 0

    def setpoints(self, raw, now_ns):
        payload = setpoints_payload(self._registers, raw, self._motors, self._feedback_s)
        self._sequence = self._sequence + 1 & 0xFFFF
        return build(Frame(Type.SETPOINTS, self._sequence, now_ns // NS_PER_US, payload))
