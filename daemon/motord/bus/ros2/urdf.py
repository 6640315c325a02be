# SPDX-License-Identifier: Apache-2.0
"""Makes a robot description (URDF) from the robot file. The track, and radii and axes of wheels,
are exact; the width of a wheel, the distance between wheels of one side of a base that cannot
strafe, and the shape of the base are for display only. base_link is on the ground, in the middle
between the wheels, as in the odometry."""

from __future__ import annotations

import math
from types import SimpleNamespace
from xml.etree.ElementTree import Element, SubElement, tostring

from motord.bus.messages.cdr import encode
from motord.config import Joint, Robot
from motord.config.sections.bases import wheel_place

DESCRIPTION, STRING = "robot_description", "std_msgs/msg/String"
"""Topic of the robot description, and the type of that topic."""
WHEEL_WIDTH = 0.4
"""Width of a wheel, as a multiple of its radius."""
SPACING = 2.2
"""Distance between wheels of one side, as a multiple of the radius: the robot file does not contain
it."""


def description(robot: Robot) -> bytes:
    """Return the message of the topic `robot_description`, in CDR."""
    return bytes(encode(STRING, SimpleNamespace(data=urdf(robot))))


def urdf(robot: Robot) -> str:
    """Return the URDF: one link and one continuous joint for each wheel, named as in
    joint_states."""
    root = Element("robot", name=robot.robot.name)
    radius_m, track_m = robot.base.wheel_radius_m, robot.base.track_m
    base = SubElement(root, "link", name="base_link")
    _footprint(root)
    _box(base, track_m, track_m - 2.0 * WHEEL_WIDTH * radius_m, radius_m)
    if robot.base.strafes:
        for name, joint in robot.joint.items():
            x_m, y_m, rolling_rad = wheel_place(robot.base, joint)
            _wheel(root, name, joint, radius_m, (x_m, y_m), rolling_rad)
        return tostring(root, encoding="unicode")
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wheels = {name: joint for name, joint in robot.joint.items() if joint.side == side}
        first_m = SPACING * radius_m * (len(wheels) - 1) / 2.0
        for number, (name, joint) in enumerate(wheels.items()):
            x_m = first_m - SPACING * radius_m * number
            _wheel(root, name, joint, radius_m, (x_m, sign * track_m / 2.0))
    return tostring(root, encoding="unicode")


def _footprint(root: Element) -> None:
    """Add base_footprint, the frame on the floor that navigation expects (REP-120). It is a child
    of base_link, because the odometry frame is the parent of base_link already."""
    SubElement(root, "link", name="base_footprint")
    joint = SubElement(root, "joint", name="footprint", type="fixed")
    SubElement(joint, "parent", link="base_link")
    SubElement(joint, "child", link="base_footprint")
    SubElement(joint, "origin", xyz=_numbers(0.0, 0.0, 0.0), rpy="0 0 0")


def _box(link: Element, length_m: float, width_m: float, wheel_radius_m: float) -> None:
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=_numbers(0.0, 0.0, 1.5 * wheel_radius_m), rpy="0 0 0")
    geometry = SubElement(visual, "geometry")
    SubElement(geometry, "box", size=_numbers(length_m, max(width_m, 0.01), wheel_radius_m))


def _wheel(
    root: Element,
    name: str,
    joint: Joint,
    base_radius_m: float,
    place_m: tuple[float, float],
    rolling_rad: float = 0.0,
) -> None:
    radius_m = joint.wheel_radius_m or base_radius_m
    link = f"{name}_wheel"
    made = SubElement(root, "joint", name=name, type="continuous")
    SubElement(made, "parent", link="base_link")
    SubElement(made, "child", link=link)
    SubElement(
        made, "origin", xyz=_numbers(*place_m, radius_m), rpy=_numbers(0.0, 0.0, rolling_rad)
    )
    SubElement(made, "axis", xyz="0 1 0")
    visual = SubElement(SubElement(root, "link", name=link), "visual")
    SubElement(visual, "origin", xyz="0 0 0", rpy=_numbers(math.pi / 2.0, 0.0, 0.0))
    geometry = SubElement(visual, "geometry")
    length = f"{WHEEL_WIDTH * radius_m:.6g}"
    SubElement(geometry, "cylinder", radius=f"{radius_m:.6g}", length=length)


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)
