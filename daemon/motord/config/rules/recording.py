# SPDX-License-Identifier: Apache-2.0
"""The memory of a recorder, and a rule for what has no room there."""

from __future__ import annotations

from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.sections.bus import McapPublish
from motord.config.sections.model import Robot

MEMORY_BYTES = 192_000_000
"""Memory of all recorders together, of the 512 MiB that motord-bus has."""
MESSAGE_BYTES = 1000
"""Memory of one message, at most as a rule."""
JOURNAL_TICK_BYTES = 40
"""Memory of one tick in the journal: docs/replay.md."""


def memory_bytes(robot: Robot) -> int:
    """Return the memory that one recorder has."""
    return MEMORY_BYTES // max(1, len(list(_recorders(robot))))


def memory_holds_the_time_before_a_fault(robot: Robot) -> Iterator[Finding]:
    """Warn if memory may not hold the time before a fault: how long messages are depends on the
    robot."""
    for name, section in _recorders(robot):
        bytes_s = MESSAGE_BYTES * sum(section.rates_hz().values())
        if section.journal:
            bytes_s += JOURNAL_TICK_BYTES * robot.loop.rate_hz
        holds_s = memory_bytes(robot) / bytes_s
        if section.mode == "fault" and section.before_s + section.after_s > holds_s:
            text = f"memory holds {holds_s:.0f} s at these rates: older messages are lost, counted"
            yield Finding((("publish", name, "before_s"),), text, warning=True)


def _recorders(robot: Robot) -> Iterator[tuple[str, McapPublish]]:
    for name, section in robot.publish.items():
        if isinstance(section, McapPublish):
            yield name, section
