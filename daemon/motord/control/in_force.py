# SPDX-License-Identifier: Apache-2.0
"""Parameters of a robot that may change while it runs, with their values in force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from motord.config import Limits, Robot
from motord.config.sections.joint.limits import JointLimits, limit_keys
from motord.config.sections.joint.speed_loop import SpeedLoop
from motord.config.sections.joint.wheels import gains_of
from motord.control.assembly import base_limits, joint_limits, speed_loop_gains
from motord.realtime.types import SpeedLoopGains


class InForce:
    """The parameters in force; at first those of the robot file."""

    def __init__(self, robot: Robot) -> None:
        profiles = robot.profiles
        self._robot = robot
        self.limits: Limits = robot.limits
        self.speed_loops: dict[str, SpeedLoop] = {
            name: joint.speed_loop or SpeedLoop()
            for name, joint in robot.joint.items()
            if gains_of(joint, profiles[joint.drive])
        }
        """Settings by joint, for the joints whose speed motord holds or could hold."""
        self._gains_count = 0
        self._gains: tuple[SpeedLoopGains, ...] = ()
        self.joint_limits: dict[str, JointLimits] = {
            name: JointLimits.of(joint)
            for name, joint in robot.joint.items()
            if limit_keys(robot, name)
        }
        """Limits by joint; empty for a robot with a base."""
        self._joint_limits_count = 0

    def change_joint_limits(self, limits: Mapping[str, JointLimits]) -> None:
        """Put limits in force that have been checked."""
        self.joint_limits |= limits
        self._joint_limits_count += 1

    def change_speed_loops(self, loops: Mapping[str, SpeedLoop]) -> None:
        """Put gains in force that have been checked, without a step of the output."""
        self.speed_loops |= loops
        profiles = self._robot.profiles
        self._gains = tuple(
            speed_loop_gains(joint, profiles[joint.drive], self.speed_loops[name])
            if name in self.speed_loops
            else SpeedLoopGains()
            for name, joint in self._robot.joint.items()
        )
        self._gains_count += 1

    def levels(self) -> dict[str, Any]:
        """Return the parameters' part of the core's control."""
        return {
            "limits": base_limits(self.limits),
            "joint_limits_count": self._joint_limits_count,
            "joint_limits": tuple(map(joint_limits, self.joint_limits.values())),
            "gains_count": self._gains_count,
            "gains": self._gains,
        }
