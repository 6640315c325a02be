# SPDX-License-Identifier: Apache-2.0
"""[odometry] of the robot file."""

from __future__ import annotations

from motord.config.sections.section import Section, number


class Odometry(Section):
    """Error model of the odometry: Siegwart & Nourbakhsh, Autonomous Mobile Robots, 5.2.4.

    The defaults are what an uncalibrated base does, about 1 % of the distance and 3 % of the turn
    (Borenstein & Feng, Measurement and Correction of Systematic Odometry Errors in Mobile
    Robots, IEEE Transactions on Robotics and Automation 12(6), 1996); the floors are a millimetre
    and a milliradian. Speed and turn rate are as uncertain as they are seen to be; their floors,
    0.1 mm/s and 0.1 mrad/s, only keep a variance from being zero.
    """

    distance_variance_m2_per_m: float = number(
        "variance of one side's travel for each metre of it", 1e-9, 1, "m²/m", 1e-4
    )
    turn_variance_rad2_per_rad: float = number(
        "variance of the heading for each radian turned", 1e-9, 1, "rad²/rad", 1e-3
    )
    pose_variance_floor_m2: float = number("least variance of x and y", 1e-12, 1, "m²", 1e-6)
    heading_variance_floor_rad2: float = number(
        "least variance of the heading", 1e-12, 1, "rad²", 1e-6
    )
    twist_variance_floor_m2_s2: float = number(
        "least variance of the speed", 1e-12, 1, "m²/s²", 1e-8
    )
    twist_variance_floor_rad2_s2: float = number(
        "least variance of the turn rate", 1e-12, 1, "rad²/s²", 1e-8
    )
