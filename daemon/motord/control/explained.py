# SPDX-License-Identifier: Apache-2.0
"""The core's faults as texts for a person."""

from __future__ import annotations

from motord.api.snapshot import Snapshot
from motord.config import Robot
from motord.config.sections.joint.wheels import takes_position
from motord.control.doubt import doubt_text
from motord.control.machine import Facts

COARSE_COUNTER = (
    "%s: the drive's counter is a floating-point number that has become coarse: its position and, "
    "without a speed of the drive's own, its speed come in steps; restart the drive"
)


def explained(snapshot: Snapshot, facts: Facts, robot: Robot, broken: str | None) -> list[str]:
    """Return the core's faults, with names and details where they are known. `broken`: why the
    daemon itself reported a fault."""
    details = {
        "estop": facts.estop_input,
        "feedback_stale": ", ".join(facts.stale_joints),
        "position_unknown": ", ".join(facts.lost_positions),
        "drive": "; ".join(facts.drive_faults),
        "external": broken or "",
        "suspended": "the computer was suspended; look at the robot, then motord reset",
    }
    if snapshot.doubt is not None:
        name, joint = list(robot.joint.items())[snapshot.doubt.joint]
        positioned = takes_position(joint, robot.profiles[joint.drive])
        text = doubt_text(snapshot.doubt, name, snapshot.stamp_ns, takes_position=positioned)
        details[snapshot.doubt.fault] = text
    return [
        f"{fault}: {details[fault]}" if details.get(fault) else fault for fault in snapshot.faults
    ]
