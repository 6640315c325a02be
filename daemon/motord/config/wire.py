# SPDX-License-Identifier: Apache-2.0
"""How often a wire can carry one exchange with every drive on it: frame arithmetic."""

from __future__ import annotations

from motord_hal.modbus.codec import character_bits, frame_time_s, silent_interval_s
from motord_hal.ports import JointSpec, LineSpec

# request and reply in bytes (Modbus application protocol V1.1b3, 6.3, 6.6 and 6.12), CRC included
_READ_BYTES = 8 + 5
_WRITE_BYTES = {6: 8 + 8, 16: 9 + 8}


def cycle_limit_hz(spec: LineSpec) -> float:
    """Highest cyclic rate of a Modbus RTU line: set-points written and feedback read once a drive,
    with the silence between frames, and with drives that answer at once."""
    silence_s = spec.gap_s
    if silence_s is None:
        bits = character_bits(spec.parity, spec.stop_bits)
        silence_s = silent_interval_s(spec.baudrate, bits)
    total_s = 0.0
    for unit in {joint.unit for joint in spec.joints}:
        joints = [joint for joint in spec.joints if joint.unit == unit]
        requests, size_bytes = _exchange(joints)
        wire_s = frame_time_s(size_bytes, spec.baudrate, spec.parity, spec.stop_bits)
        total_s += wire_s + 2 * requests * silence_s
    return 1 / total_s


def _exchange(joints: list[JointSpec]) -> tuple[int, int]:
    """Requests and bytes of one cycle with one drive, when its registers lie side by side."""
    profile = joints[0].profile
    channels = [profile.channels[joint.channel] for joint in joints]
    written = [channel.velocity_setpoint or channel.duty_setpoint or "" for channel in channels]
    read = {name for channel in channels for name in (channel.position, channel.velocity)}
    read |= {channel.fault for channel in channels}
    words = sum(profile.registers[name].type.words for name in read if name)
    writes = len(written) if profile.write_function == 6 else 1
    size_bytes = writes * _WRITE_BYTES[profile.write_function] + _READ_BYTES + 2 * words
    if profile.write_function == 16:
        size_bytes += sum(2 * profile.registers[name].type.words for name in written)
    return writes + 1, size_bytes
