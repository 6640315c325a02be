# SPDX-License-Identifier: Apache-2.0
"""Texts for a person on why the core does not believe its feedback."""

from __future__ import annotations

import math

from motord.api.snapshot import DoubtSnapshot

_CHECK = {
    "direction": "turns in the wrong direction: check the joint's `inverted`, the motor's and the "
    "encoder's wires",
    "stall": "does not turn: check that it is free, its motor's wires, its encoder and the cable",
    "following_error": "does not follow: check the load, the drive's current and speed limits, and"
    " counts_per_turn and gear_ratio of the joint",
    "runaway": "is faster than its set-point: check the drive's settings, the encoder and its"
    " wires",
    "implausible_feedback": "has feedback that cannot be true: check the encoder, its cable, and"
    " counts_per_turn and gear_ratio of the joint",
}


def doubt_text(
    doubt: DoubtSnapshot, joint: str, now_ns: int, *, takes_position: bool = False
) -> str:
    """Return one sentence: which wheel, what was measured, since when, and what to check."""
    if takes_position and doubt.fault == "following_error":
        return (
            f"{joint} has been far from its set-point for {(now_ns - doubt.since_ns) / 1e9:.1f} s"
            " and comes no nearer: check that it is free, its drive's current and speed limits, and"
            " zero_count, counts_per_turn and gear_ratio of the joint"
        )
    reported = ""
    if math.isfinite(doubt.reported_rad_s) and doubt.fault == "implausible_feedback":
        reported = f", {doubt.reported_rad_s:.2f} rad/s reported by its drive"
    since_s = (now_ns - doubt.since_ns) / 1e9
    return (
        f"{joint} {_CHECK.get(doubt.fault, 'is not believed')} ({doubt.measured_rad_s:.2f} rad/s"
        f" measured{reported} at a set-point of {doubt.setpoint_rad_s:.2f} rad/s, for"
        f" {since_s:.1f} s)"
    )
