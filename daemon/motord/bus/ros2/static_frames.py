# SPDX-License-Identifier: Apache-2.0
"""The frames that never move, for tf_static: the fixed joints of the robot description."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import SimpleNamespace
from xml.etree.ElementTree import Element, ParseError, fromstring

STATIC = "tf_static"
"""Topic of the frames that never move."""


def static_transforms(description: str, stamp_ns: int, prefix: str = "") -> SimpleNamespace:
    """Return the tf2_msgs/TFMessage of the description's fixed joints; readers of joint_states
    compute the joints that turn. `stamp_ns`: wall time; `prefix` goes before each frame name.
    Raises ValueError if the description is not valid URDF."""
    try:
        root = fromstring(description)
    except ParseError as error:
        raise ValueError(f"the robot description is not XML: {error}") from error
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
    return SimpleNamespace(transforms=tuple(_frames(root, stamp, prefix)))


def _frames(root: Element, stamp: SimpleNamespace, prefix: str) -> Iterator[SimpleNamespace]:
    for joint in root.findall("joint"):
        if joint.get("type") != "fixed":
            continue
        names = [prefix + _link(joint, end) for end in ("parent", "child")]
        origin = joint.find("origin")
        x_m, y_m, z_m = _three(joint, origin, "xyz")
        turn = _quaternion(*_three(joint, origin, "rpy"))
        place = SimpleNamespace(x=x_m, y=y_m, z=z_m)
        yield SimpleNamespace(
            header=SimpleNamespace(stamp=stamp, frame_id=names[0]),
            child_frame_id=names[1],
            transform=SimpleNamespace(translation=place, rotation=turn),
        )


def _link(joint: Element, end: str) -> str:
    found = joint.find(end)
    name = None if found is None else found.get("link")
    if not name:
        raise ValueError(f"joint {joint.get('name')!r} has no {end}")
    return name


def _three(joint: Element, origin: Element | None, key: str) -> tuple[float, float, float]:
    """Return the three numbers of an attribute; zeros if it is missing
    (wiki.ros.org/urdf/XML/joint)."""
    words = "" if origin is None else origin.get(key, "")
    try:
        numbers = [float(word) for word in (words or "0 0 0").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"joint {joint.get('name')!r}: {key} is {words!r}, not three numbers")
    return numbers[0], numbers[1], numbers[2]


def _quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> SimpleNamespace:
    """Return the quaternion of turns about the fixed x, then y, then z axis
    (wiki.ros.org/urdf/XML/joint: rpy)."""
    (sx, cx), (sy, cy), (sz, cz) = (
        (math.sin(angle_rad / 2.0), math.cos(angle_rad / 2.0))
        for angle_rad in (roll_rad, pitch_rad, yaw_rad)
    )
    return SimpleNamespace(
        x=sx * cy * cz - cx * sy * sz,
        y=cx * sy * cz + sx * cy * sz,
        z=cx * cy * sz - sx * sy * cz,
        w=cx * cy * cz + sx * sy * sz,
    )
