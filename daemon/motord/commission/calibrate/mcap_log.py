# SPDX-License-Identifier: Apache-2.0
"""Read a recording in MCAP for `calibrate --from`: joint_states, and poses on a topic of another
system. Needs the extra `calibrate`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motord.api.geometry_fit import Array
from motord.base.extras import how_to_install
from motord.commission.calibrate.log_fit import ROWS_MAX, Log, sides_of
from motord.commission.person import Failed

JOINTS = "joint_states"
"""Last part of the topic's name."""


def read_mcap(
    path: Path, topic: str, sides: Mapping[str, str], radii_m: Mapping[str, float]
) -> Log:
    """Read the poses (geometry_msgs/PoseStamped, or nav_msgs/Odometry) at the times of the joint
    states, by the stamps in both. Raises Failed."""
    joints: list[list[float]] = []
    poses: list[list[float]] = []
    topics: set[str] = set()
    for name, message in _messages(path):
        topics.add(name)
        try:
            if name == topic:
                poses.append(_pose(message))
            elif name.rpartition("/")[2] == JOINTS:
                found = dict(zip(message.name, message.position, strict=False))
                if all(joint in found for joint in sides):
                    joints.append([_stamp_s(message), *(float(found[joint]) for joint in sides)])
        except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
            kinds = "PoseStamped or Odometry" if name == topic else "JointState"
            raise Failed(f"{path}: a message on {name} is no {kinds}: {error}") from error
        if len(joints) + len(poses) > ROWS_MAX:
            raise Failed(f"{path}: has more than {ROWS_MAX} messages: cut it")
    if not poses or not joints:
        lacks = topic if not poses else f"{JOINTS} with {', '.join(sides)}"
        raise Failed(
            f"{path}: has no {lacks}; topics: {', '.join(sorted(topics)) or 'none'} (--pose-topic)"
        )
    return _joined(path, np.array(poses), np.array(joints), sides, radii_m)


def _joined(
    path: Path, poses: Array, joints: Array, sides: Mapping[str, str], radii_m: Mapping[str, float]
) -> Log:
    for table in (poses, joints):
        if not np.all(np.isfinite(table)):
            raise Failed(f"{path}: a value is not finite")
        table[:] = table[np.argsort(table[:, 0], kind="stable")]
    inside = (joints[:, 0] >= poses[0, 0]) & (joints[:, 0] <= poses[-1, 0])
    joints = joints[inside]
    if len(joints) < 2:
        raise Failed(f"{path}: poses and joint states do not overlap in time: use one clock")
    heading_rad = np.unwrap(poses[:, 3])
    columns = [
        np.interp(joints[:, 0], poses[:, 0], part) for part in (*poses[:, 1:3].T, heading_rad)
    ]
    left, right = sides_of(joints[:, 1:], sides, radii_m)
    return Log(np.stack(columns, axis=1), left, right)


def _messages(path: Path) -> Iterator[tuple[str, Any]]:
    try:
        from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue
        from mcap_ros2.decoder import DecoderFactory

        from motord.base.mcap_file import DamagedFile, decoded_messages
    except ImportError as error:
        raise Failed(f"MCAP needs more packages: {how_to_install('calibrate')}") from error
    try:
        of_schemas = (InvalidSpecification, InvalidValue, NameError)
        yield from decoded_messages(path, [DecoderFactory()], of_schemas)
    except DamagedFile as error:
        raise Failed(str(error)) from error
    except OSError as error:
        raise Failed(f"{path}: cannot be read: {error.strerror or error}") from error


def _pose(message: Any) -> list[float]:
    pose = message.pose
    pose = getattr(pose, "pose", pose)  # nav_msgs/Odometry has a pose with a covariance
    at, turn = pose.position, pose.orientation
    # yaw of a quaternion: REP 103, rotation about z
    heading_rad = math.atan2(
        2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2)
    )
    return [_stamp_s(message), float(at.x), float(at.y), heading_rad]


def _stamp_s(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9
