# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the gyro: its offset at rest, and its scale by turns that end at a mark."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from motord.api.motion import Goal
from motord.client import Client
from motord.commission.person import Failed, Person
from motord.commission.robot_file_edit import KeyPath
from motord.commission.session import armed
from motord.config import Robot

OWNER = "motord-calibrate"
STILL_S = 3.0
SCALE_MIN, SCALE_MAX = 0.8, 1.25
VARIANCE_MIN_RAD2_PER_RAD = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class GyroFound:
    """The result. `scale`: true turn over the turn that the gyro has counted."""

    bias_rad_s: float
    scale: float
    difference: float
    """Difference between the scales of both directions: how exact the measure is."""


def measure_gyro(
    client: Client, person: Person, robot: Robot, turns: float, angular_rad_s: float
) -> GyroFound:
    """Turn left and right, and request the angle to the mark. Raises Failed, Aborted."""
    if robot.imu is None:
        raise Failed("the robot file has no [imu]")
    if not person.confirm(
        f"Mark on the floor where the robot's nose points. It turns {turns:g} times to the left "
        f"and then to the right, with at most {angular_rad_s:g} rad/s. Is there room all around?"
    ):
        raise Failed("nothing was driven")
    scales, before_rad, bias_rad_s = [], 0.0, math.nan
    for angle_rad in (turns * math.tau, -turns * math.tau):
        with armed(client, person, OWNER) as session:
            still = session.wait_still(STILL_S)[-1].imu
            if still is None or still.state != "used":
                state = "sends nothing" if still is None else f"is {still.state}"
                raise Failed(f"the gyro {state}: it does not give the heading (motord status)")
            bias_rad_s = still.bias_rad_s
            goal = Goal(axis="angular", distance_u=angle_rad, velocity_u_s=angular_rad_s)
            moved = session.carry_out(
                goal, lambda motion, _: person.progress(f"turned {motion.distance_u:.2f} rad")
            )
            session.wait_still(0.5)
        after_rad = math.radians(
            person.number(
                "By how many degrees does the nose point to the left of its mark "
                "(to the right: negative)?", "°", -180.0, 180.0,
            )
        )  # fmt: skip
        scales.append((angle_rad + after_rad - before_rad) / moved.angle_rad)
        before_rad = after_rad
    scale = sum(scales) / len(scales)
    if not SCALE_MIN <= scale <= SCALE_MAX:
        raise Failed(f"a scale of {scale:.3f} is too far from 1 for a gyro: check the mark, repeat")
    return GyroFound(bias_rad_s=bias_rad_s, scale=scale, difference=abs(scales[0] - scales[1]))


def gyro_changes(found: GyroFound) -> dict[KeyPath, Any]:
    """Return the key for the variance that the scale's error causes: (error · 2π)² for a turn of
    2π. The robot file has no scale, and the daemon measures the offset again at each rest."""
    variance = (found.scale - 1.0) ** 2 * math.tau
    key = ("imu", "turn_variance_rad2_per_rad")
    return {key: float(f"{max(variance, VARIANCE_MIN_RAD2_PER_RAD):.3g}")}
