# SPDX-License-Identifier: Apache-2.0
"""Limits of a joint without a base. They can be changed while the daemon runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from motord.config.sections.bases import JointsBase
from motord.config.sections.joint.wheels import takes_position
from motord.config.sections.limits import braking_s
from motord.config.sections.model import Joint, Robot
from motord.config.sections.section import Number, numbers_of


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Limits of one joint: the keys of [joint.NAME] with these names."""

    velocity_max_rad_s: float
    acceleration_max_rad_s2: float
    deceleration_max_rad_s2: float
    jerk_max_rad_s3: float

    @classmethod
    def of(cls, joint: Joint) -> Self:
        """Return the limits that the robot file gives."""
        falls_rad_s2 = joint.deceleration_max_rad_s2
        return cls(
            velocity_max_rad_s=joint.velocity_max_rad_s or 0.0,
            acceleration_max_rad_s2=joint.acceleration_max_rad_s2,
            deceleration_max_rad_s2=falls_rad_s2 or joint.acceleration_max_rad_s2,
            jerk_max_rad_s3=joint.jerk_max_rad_s3,
        )

    def rest_s(self, velocity_rad_s: float = 0.0) -> float:
        """Return how long a stop takes at most: from full speed, or from this speed if it is
        higher."""
        velocity_rad_s = max(self.velocity_max_rad_s, abs(velocity_rad_s))
        return braking_s(velocity_rad_s, self.deceleration_max_rad_s2, self.jerk_max_rad_s3)

    def ramp_s(self, velocity_rad_s: float) -> float:
        """Return the time within which a joint at this speed comes to rest, whatever its
        acceleration is."""
        falls_rad_s2 = self.deceleration_max_rad_s2
        return abs(velocity_rad_s) / falls_rad_s2 + 2.0 * falls_rad_s2 / self.jerk_max_rad_s3


KEYS = (
    "velocity_max_rad_s",
    "acceleration_max_rad_s2",
    "deceleration_max_rad_s2",
    "jerk_max_rad_s3",
)
_POSITION_KEYS = KEYS[:2]
NUMBERS: Mapping[str, Number] = {key: numbers_of(Joint)[key] for key in KEYS}


def limit_keys(robot: Robot, name: str) -> tuple[str, ...]:
    """Return the keys of the limits that this joint has; empty if a base has limits for all
    joints."""
    if not isinstance(robot.base, JointsBase):
        return ()
    joint = robot.joint[name]
    return _POSITION_KEYS if takes_position(joint, robot.profiles[joint.drive]) else KEYS
