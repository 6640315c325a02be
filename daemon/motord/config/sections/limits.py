# SPDX-License-Identifier: Apache-2.0
"""[limits]: speed, acceleration, deceleration and jerk of each axis, and how long a stop takes."""

from __future__ import annotations

import math

from motord.config.sections.section import Section, number, numbers_of


class Limits(Section):
    """Limits of the base's motion. They can be changed while the daemon runs."""

    linear_m_s: float = number("speed", 0.001, 50, "m/s", 0.5)
    linear_m_s2: float = number("acceleration", 0.001, 100, "m/s²", 0.5)
    linear_deceleration_m_s2: float = number(
        "deceleration; as the acceleration where it is not given",
        0.001,
        100,
        "m/s²",
        lambda above: above["linear_m_s2"],
    )
    linear_m_s3: float = number("jerk; inf: no limit", 0.001, None, "m/s³", math.inf)
    angular_rad_s: float = number("turn rate", 0.001, 100, "rad/s", 1.0)
    angular_rad_s2: float = number("turn acceleration", 0.001, 1000, "rad/s²", 1.0)
    angular_deceleration_rad_s2: float = number(
        "turn deceleration; as the acceleration where it is not given",
        0.001,
        1000,
        "rad/s²",
        lambda above: above["angular_rad_s2"],
    )
    angular_rad_s3: float = number("turn jerk; inf: no limit", 0.001, None, "rad/s³", math.inf)
    lateral_m_s: float = number(
        "speed sideways; as linear_m_s where it is not given. Only of a base that moves sideways, "
        "as the next three",
        0.001,
        50,
        "m/s",
        lambda above: above["linear_m_s"],
    )
    lateral_m_s2: float = number(
        "acceleration sideways; as linear_m_s2 where it is not given",
        0.001,
        100,
        "m/s²",
        lambda above: above["linear_m_s2"],
    )
    lateral_deceleration_m_s2: float = number(
        "deceleration sideways; as linear_deceleration_m_s2 where it is not given",
        0.001,
        100,
        "m/s²",
        lambda above: above["linear_deceleration_m_s2"],
    )
    lateral_m_s3: float = number(
        "jerk sideways; as linear_m_s3 where it is not given; inf: no limit",
        0.001,
        None,
        "m/s³",
        lambda above: above["linear_m_s3"],
    )

    def linear_rest_s(self, linear_m_s: float) -> float:
        """Return how long a stop takes from this speed on a straight line."""
        return braking_s(linear_m_s, self.linear_deceleration_m_s2, self.linear_m_s3)

    def axes_rest_s(self) -> tuple[float, float]:
        """Return how long each axis alone takes from full speed to rest: linear, angular."""
        linear_s = self.linear_rest_s(self.linear_m_s)
        angular_s = braking_s(
            self.angular_rad_s, self.angular_deceleration_rad_s2, self.angular_rad_s3
        )
        return linear_s, angular_s

    def rest_s(
        self,
        linear_m_s: float = 0.0,
        angular_rad_s: float = 0.0,
        lateral_m_s: float = 0.0,
        *,
        strafes: bool,
    ) -> float:
        """Return how long a stop takes at most: from full speed, or from these speeds if they are
        higher. `strafes`: whether the base moves sideways, too."""
        linear = max(self.linear_m_s, abs(linear_m_s))
        angular = max(self.angular_rad_s, abs(angular_rad_s))
        # all axes slow down in proportion: the weakest one sets both, as shares of its full speed
        deceleration = min(
            self.linear_deceleration_m_s2 / linear, self.angular_deceleration_rad_s2 / angular
        )
        jerk = min(self.linear_m_s3 / linear, self.angular_rad_s3 / angular)
        if strafes:
            lateral = max(self.lateral_m_s, abs(lateral_m_s))
            deceleration = min(deceleration, self.lateral_deceleration_m_s2 / lateral)
            jerk = min(jerk, self.lateral_m_s3 / lateral)
        return braking_s(1.0, deceleration, jerk)


LATERAL_KEYS = frozenset(key for key in numbers_of(Limits) if key.startswith("lateral_"))
"""Keys of a base that moves sideways; other bases have no such limits."""
REST_MAX_S = 20.0
"""Longest stop; limits by which a stop takes longer are refused."""


def braking_s(velocity: float, deceleration: float, jerk: float) -> float:
    """Return the time from a velocity to rest. The deceleration rises by the jerk, and may not get
    to its limit."""
    if velocity * jerk < deceleration**2:
        return 2.0 * math.sqrt(velocity / jerk)
    return velocity / deceleration + deceleration / jerk
