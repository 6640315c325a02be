# SPDX-License-Identifier: Apache-2.0
"""The silent interval of a line: from the robot file, else the longest that a drive needs."""

from __future__ import annotations

from motord_hal.drives.profile import DriveProfile, Gap
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.codec import SILENT_CHARACTERS, character_bits, silent_interval_s


def line_gap_s(spec: LineSpec) -> float:
    """Return the silence before each request of the line, in seconds."""
    if spec.gap_s is not None:
        return spec.gap_s
    if spec.gap is not None:
        return rule_gap_s(spec.gap, spec)
    gaps_s = [drive_gap_s(joint.profile, spec) for joint in spec.joints]
    return max(gaps_s, default=rule_gap_s(Gap.SPEC, spec))


def drive_gap_s(profile: DriveProfile, spec: LineSpec) -> float:
    """Return the silence that a drive needs before a request, in seconds, with the line's
    characters."""
    return rule_gap_s(profile.gap, spec) if profile.gap_s is None else profile.gap_s


def rule_gap_s(gap: Gap, spec: LineSpec) -> float:
    """Return a rule's silence in seconds, with the line's characters."""
    bits = character_bits(spec.parity, spec.stop_bits)
    if gap is Gap.SPEC:
        return silent_interval_s(spec.baudrate, bits)
    return SILENT_CHARACTERS * bits / spec.baudrate
