# SPDX-License-Identifier: Apache-2.0
"""From a snapshot to JSON without a message in between, for the topics that come often: `json_form`
as a form of a feed.

One document for each topic is made of the first message; what changes is written into it, and
msgspec writes it out. Without msgspec, and where it is not the usual case, a message is built.
"""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from math import cos, hypot, isfinite, sin
from typing import Any

from motord.bus.messages import json_form
from motord.bus.messages.from_snapshot import Body, state_name
from motord.bus.messages.topics import Topic, View

try:
    import msgspec
except ImportError:  # json_form does without, too
    msgspec = None  # type: ignore[assignment]

Encoder = Callable[[View, int], "bytes | None"]
_NS = 1_000_000_000


def encoder(topic: Topic, body: Body) -> Encoder:
    """As feed.Form."""
    long_way = _long_way(topic, body)
    document = None if msgspec is None else _DOCUMENTS.get(topic.name)
    return long_way if document is None else document(topic, body, long_way).encoded


def _long_way(topic: Topic, body: Body) -> Encoder:
    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        message = topic.build(view, body, wall_offset_ns)
        return None if message is None else json_form.encode(message)

    return encoded


def _at(document: Any, *path: str | int) -> Any:
    return functools.reduce(operator.getitem, path, document)


def _sparse(values: list[float], changing: Iterable[int]) -> list[Any]:
    """Those places, and what is between them as text that is ready."""
    found: list[Any] = []
    begin = 0
    for place in (*changing, len(values)):
        if constant := values[begin:place]:
            found.append(msgspec.Raw(json_form.encode(constant)[1:-1]))
        if place < len(values):
            found.append(values[place])
        begin = place + 1
    return found


class _Document(ABC):
    """Of one topic; `document` is None until there was a message."""

    def __init__(self, topic: Topic, body: Body, long_way: Encoder) -> None:
        self._topic = topic
        self._body = body
        self._long_way = long_way
        self._encode = msgspec.json.Encoder().encode
        self._document: Any = None

    def encoded(self, view: View, wall_offset_ns: int) -> bytes | None:
        if self._document is None:
            message = self._topic.build(view, self._body, wall_offset_ns)
            if message is None:
                return None
            self._document = json_form.plain(message)
            self._find()
        if not self._fill(view, wall_offset_ns):
            return self._long_way(view, wall_offset_ns)
        return self._encode(self._document)

    @abstractmethod
    def _find(self) -> None:
        """Keep what is written into."""

    @abstractmethod
    def _fill(self, view: View, wall_offset_ns: int) -> bool:
        """False: not the usual case."""


class _Odometry(_Document):
    def _find(self) -> None:
        find = functools.partial(_at, self._document)
        self._stamp = find("header", "stamp")
        self._position = find("pose", "pose", "position")
        self._turn = find("pose", "pose", "orientation")
        self._linear = find("twist", "twist", "linear")
        self._angular = find("twist", "twist", "angular")
        self._pose, self._twist = find("pose"), find("twist")
        self._pose["covariance"] = self._pose_covariance = _sparse(
            self._pose["covariance"], (0, 1, 5, 6, 7, 11, 30, 31, 35)
        )
        self._twist["covariance"] = self._twist_covariance = _sparse(
            self._twist["covariance"], (0, 5, 7, 30, 35)
        )

    def _fill(self, view: View, wall_offset_ns: int) -> bool:
        now = view.snapshot
        x_m, y_m, half_rad = now.x_m, now.y_m, 0.5 * now.heading_rad
        linear_m_s, angular_rad_s = now.linear_m_s, now.angular_rad_s
        if not now.odometry_stamp_ns or not isfinite(
            x_m + y_m + half_rad + linear_m_s + angular_rad_s
        ):
            return False
        stamp, position, turn = self._stamp, self._position, self._turn
        wall_ns = now.odometry_stamp_ns + wall_offset_ns
        stamp["sec"] = sec = wall_ns // _NS
        stamp["nanosec"] = wall_ns - sec * _NS
        position["x"], position["y"] = x_m, y_m
        turn["z"], turn["w"] = sin(half_rad), cos(half_rad)
        self._linear["x"], self._angular["z"] = linear_m_s, angular_rad_s
        pose, twist = self._pose_covariance, self._twist_covariance
        # xx xy 000 xh | xy yy 000 yh | untold | xh yh 000 hh
        pose[0], pose[1], pose[3], pose[5], pose[7], pose[12] = now.pose_covariance
        pose[4], pose[9], pose[10] = pose[1], pose[3], pose[7]
        # vv 0000 vw | 0 vv | untold | vw 0000 ww
        twist[0], twist[2], twist[8] = now.twist_covariance
        twist[4], twist[6] = twist[0], twist[2]
        return True


class _Transforms(_Document):
    def _find(self) -> None:
        find = functools.partial(_at, self._document, "transforms", 0)
        self._stamp = find("header", "stamp")
        self._place = find("transform", "translation")
        self._turn = find("transform", "rotation")

    def _fill(self, view: View, wall_offset_ns: int) -> bool:
        now = view.snapshot
        x_m, y_m, half_rad = now.x_m, now.y_m, 0.5 * now.heading_rad
        if not now.odometry_stamp_ns or not isfinite(x_m + y_m + half_rad):
            return False
        stamp, place, turn = self._stamp, self._place, self._turn
        wall_ns = now.odometry_stamp_ns + wall_offset_ns
        stamp["sec"] = sec = wall_ns // _NS
        stamp["nanosec"] = wall_ns - sec * _NS
        place["x"], place["y"] = x_m, y_m
        turn["z"], turn["w"] = sin(half_rad), cos(half_rad)
        return True


class _JointStates(_Document):
    """Of joints that have all been heard."""

    def _find(self) -> None:
        self._stamp = _at(self._document, "header", "stamp")
        self._document["name"] = msgspec.Raw(json_form.encode(self._body.joints))

    def _fill(self, view: View, wall_offset_ns: int) -> bool:
        now = view.snapshot
        positions, velocities, ages_s = [], [], []
        for joint in now.joints:
            positions.append(joint.position_rad)
            velocities.append(joint.velocity_rad_s)
            ages_s.append(joint.feedback_age_s)
        if len(positions) != len(self._body.joints) or not isfinite(hypot(*positions, *ages_s)):
            return False
        wall_ns = now.stamp_ns - round(max(ages_s) * _NS) + wall_offset_ns
        stamp, document = self._stamp, self._document
        stamp["sec"] = sec = wall_ns // _NS
        stamp["nanosec"] = wall_ns - sec * _NS
        document["position"], document["velocity"] = positions, velocities
        return True


class _MotorStatus(_Document):
    def _find(self) -> None:
        self._stamp = _at(self._document, "header", "stamp")
        self._document["name"] = msgspec.Raw(json_form.encode(self._body.joints))
        self._owner = -1
        self._status: Mapping[str, Any] | None = None

    def _fill(self, view: View, wall_offset_ns: int) -> bool:
        now, stamp, document = view.snapshot, self._stamp, self._document
        if now.owner != self._owner or view.status is not self._status:
            self._owner, self._status = now.owner, view.status
            commander = view.commander()
            document["commander"] = commander.owner if commander else ""
            document["commander_priority"] = commander.priority if commander else 0
            document["commander_why"] = commander.why if commander else ""
        wall_ns = now.stamp_ns + wall_offset_ns
        stamp["sec"] = sec = wall_ns // _NS
        stamp["nanosec"] = wall_ns - sec * _NS
        document["state"] = state_name(now)
        document["armed"], document["at_rest"] = now.armed, now.at_rest
        document["faults"], document["reasons"] = now.faults, now.reasons
        document["why"] = view.why()
        document["command_age_s"] = now.command_age_s
        document["setpoint_linear_m_s"] = now.setpoint_linear_m_s
        document["setpoint_angular_rad_s"] = now.setpoint_angular_rad_s
        document["setpoint_rad_s"] = setpoints = []
        document["duty"] = duties = []
        document["current_a"] = currents = []
        document["voltage_v"] = voltages = []
        document["temperature_c"] = temperatures = []
        document["feedback_age_s"] = ages = []
        document["drive_faults"] = faults = []
        document["stale"] = stale = []
        for joint in now.joints:
            setpoints.append(joint.setpoint_rad_s)
            duties.append(joint.duty)
            currents.append(joint.current_a)
            voltages.append(joint.voltage_v)
            temperatures.append(joint.temperature_c)
            ages.append(joint.feedback_age_s)
            faults.append(joint.drive_faults)
            stale.append(joint.stale)
        return True


_DOCUMENTS: dict[str, type[_Document]] = {
    "odom": _Odometry,
    "tf": _Transforms,
    "joint_states": _JointStates,
    "motor_status": _MotorStatus,
}
