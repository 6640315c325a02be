# SPDX-License-Identifier: Apache-2.0
"""Commands of joints without a base, by their names."""

from __future__ import annotations

from collections.abc import Mapping

from motord.api.commands import beyond
from motord.config import Robot
from motord.config.sections.bases import JointsBase
from motord.config.sections.joint.wheels import takes_position
from motord.local_socket.server import Refused


class JointNames:
    """The joints of a robot file: their places, and whether they take positions."""

    def __init__(self, robot: Robot) -> None:
        profiles = robot.profiles
        self.without_base = isinstance(robot.base, JointsBase)
        self._place = {name: place for place, name in enumerate(robot.joint)}
        self._ranges_rad = {
            name: (joint.position_min_rad or 0.0, joint.position_max_rad or 0.0)
            for name, joint in robot.joint.items()
            if takes_position(joint, profiles[joint.drive])
        }

    def places(
        self, velocity_rad_s: Mapping[str, float], position_rad: Mapping[str, float]
    ) -> tuple[dict[int, float], dict[int, float]]:
        """Return both mappings by the joints' places. Raises Refused if the robot has a base, for
        an unknown joint, and for a value that the joint does not take."""
        if not self.without_base:
            raise Refused("the joints of this robot are a base's, which moves them: motord drive")
        for name in (*velocity_rad_s, *position_rad):
            if name not in self._place:
                known = ", ".join(self._place)
                raise Refused(f"there is no joint {name[:64]!r}; there are: {known}")
            if name in self._ranges_rad and name in velocity_rad_s:
                raise Refused(f"joint {name} takes positions in rad, not velocities")
            if name not in self._ranges_rad and name in position_rad:
                raise Refused(f"joint {name} takes velocities in rad/s, not positions")
        return (
            {self._place[name]: value for name, value in velocity_rad_s.items()},
            {self._place[name]: value for name, value in position_rad.items()},
        )

    def beyond(self, position_rad: Mapping[str, float]) -> str:
        """Return which positions are beyond the ranges of their joints, in words; empty: none is.
        The loop decides, and gives no names."""
        return beyond(self._ranges_rad, position_rad)
