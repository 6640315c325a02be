# SPDX-License-Identifier: Apache-2.0
"""The silent interval of a line: from the robot file, else the longest that a drive needs. And how
late a medium may deliver a reply, for the lines of both engines."""

from __future__ import annotations

from motord_hal.drives.profile import DriveProfile, Gap
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.codec import SILENT_CHARACTERS, character_bits, silent_interval_s

LATE_UART_S = 0.02
"""Longest delay of a reply by a UART or its adapter, and by this computer, beyond what the drive
takes. FTDI's chips hold bytes back for 16 ms at most, as delivered, and replies come in the order
of their requests."""
LATE_PTY_S = 0.12
"""The same where a program passes the bytes on, perhaps over a network, or is the drive."""
LATE_NETWORK_S = 0.05
"""What a network and a gateway add to it, in both directions together."""
TCP_KINDS = ("modbus-tcp", "rtu-over-tcp")
"""Kinds of lines behind a gateway."""


def lost_reply_s(spec: LineSpec, *, rt: bool) -> float:
    """Return how much longer than its cycle a drive is without feedback when a reply was lost,
    damaged or late: the wait for the reply, and the silence in which it may still come.

    The lines in C trust the first answer after it only if it cannot be the late one, and then are
    silent for a late reply of twice the turn-around."""
    network_s = LATE_NETWORK_S + 2 * line_gap_s(spec) if spec.kind in TCP_KINDS else 0.0
    longest_s = 0.0
    for joint in spec.joints:
        usual_s = joint.profile.turnaround_s + LATE_UART_S
        wait_s = usual_s + network_s if joint.reply_timeout_s is None else joint.reply_timeout_s
        silence_s = 2 * usual_s if rt else late_silence_s(spec.kind, wait_s)
        longest_s = max(longest_s, wait_s + silence_s)
    return longest_s


def late_silence_s(kind: str, wait_s: float) -> float:
    """Return for how long a line in asyncio sends a drive nothing after it waited in vain. Modbus
    TCP numbers its replies: only the wire behind the gateway needs silence."""
    return max(wait_s - LATE_NETWORK_S, 0.0) if kind == "modbus-tcp" else wait_s


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
