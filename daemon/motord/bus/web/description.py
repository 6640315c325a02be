# SPDX-License-Identifier: Apache-2.0
"""The description of the robot for a page: names, limits, and where its wheels are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import fromstring

from motord.bus.ros2.urdf import urdf
from motord.bus.web.frames import layout
from motord.config import Robot
from motord.config.sections.bases import JointsBase, SteeredBase, wheel_modules


def description(robot: Robot) -> dict[str, Any]:
    """Return the description, ready for JSON."""
    return {
        "robot": robot.robot.name,
        "kind": robot.base.kind,
        "joints": list(robot.joint),
        "lines": {name: joint.line for name, joint in robot.joint.items()},
        "drives": {name: joint.drive for name, joint in robot.joint.items()},
        "wheels": list(_wheels(robot)),
        "limits": {
            "linear_m_s": robot.limits.linear_m_s,
            "lateral_m_s": robot.limits.lateral_m_s if robot.base.strafes else 0.0,
            "angular_rad_s": robot.limits.angular_rad_s,
        },
        "layout": layout(),
    }


def _wheels(robot: Robot) -> Iterator[dict[str, Any]]:
    """Yield the wheels, in the frame base_link. Wheels of a steered base point straight ahead; each
    has the name of the joint that drives it, or else of the one that steers it, which `steered_by`
    names too. Wheels of other bases are the continuous joints of the robot description.
    """
    for module in wheel_modules(robot.base, robot.joint):
        name = (module.traction or module.steering)[0]
        yield {
            "joint": name, "x_m": module.x_m, "y_m": module.y_m, "heading_rad": 0.0,
            "roller_rad": None, "radius_m": robot.wheel_radius_m(name),
            "steered_by": next(iter(module.steering), None),
        }  # fmt: skip
    if isinstance(robot.base, SteeredBase | JointsBase):
        return
    for joint in fromstring(urdf(robot)).iter("joint"):
        name, origin = joint.get("name", ""), joint.find("origin")
        if joint.get("type") == "continuous" and name in robot.joint and origin is not None:
            x_m, y_m, _ = _numbers(origin.get("xyz"))
            *_, heading_rad = _numbers(origin.get("rpy"))
            yield {
                "joint": name, "x_m": x_m, "y_m": y_m, "heading_rad": heading_rad,
                "roller_rad": _roller_rad(robot, x_m, y_m),
                "radius_m": robot.wheel_radius_m(name), "steered_by": None,
            }  # fmt: skip


def _roller_rad(robot: Robot, x_m: float, y_m: float) -> float | None:
    """Return the direction of the upper rollers' axes, seen from above; None: the wheel has no
    rollers that matter to a drawing."""
    if robot.base.kind != "mecanum":
        return None
    outward = 1.0 if x_m * y_m > 0.0 else -1.0  # in an X the axes point to the middle
    return math.radians(45.0) * outward * (1.0 if robot.base.rollers == "x" else -1.0)


def _numbers(text: str | None) -> tuple[float, float, float]:
    """Return three numbers; zeros if the description leaves them out."""
    first, second, third = map(float, (text or "0 0 0").split())
    return first, second, third
