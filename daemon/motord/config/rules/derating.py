# SPDX-License-Identifier: Apache-2.0
"""Rules for the derating of a joint, and between it and its drive."""

from __future__ import annotations

from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.sections.joint.derating import PAIRS
from motord.config.sections.joint.wheels import Profiles
from motord.config.sections.model import Robot


def derating(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that limits come in pairs, in the right direction, and that the drive reports their
    values."""
    for name, joint in robot.joint.items():
        if joint.derating is None:
            continue
        profile, table = profiles[joint.drive], ("joint", name, "derating")
        channel = profile.channels[joint.channel]
        reports = {
            "temperature": channel.temperature,
            "current": channel.current,
            "voltage": profile.bus_voltage,
        }
        for what, (begin, end) in PAIRS.items():
            first, last = getattr(joint.derating, begin), getattr(joint.derating, end)
            paths = ((*table, begin), (*table, end))
            if first is None and last is None:
                continue
            if first is None or last is None:
                missing, given = (begin, end) if first is None else (end, begin)
                yield Finding(((*table, missing), (*table, given)), f"is missing beside {given}")
            elif first == last or (first > last) != (what == "voltage"):
                beyond = "below" if what == "voltage" else "above"
                yield Finding((paths[1], paths[0]), f"must be {beyond} {begin} ({first:g})")
            if reports[what] is None:
                text = f'drive "{joint.drive}" does not report its {what}'
                yield Finding((*paths, ("joint", name, "drive")), text)
