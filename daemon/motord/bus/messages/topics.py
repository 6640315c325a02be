# SPDX-License-Identifier: Apache-2.0
"""The tree of topics that every bus carries: docs/buses.md."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from motord.api.snapshot import Snapshot
from motord.bus.messages import from_snapshot as messages
from motord.bus.messages import types as message_types
from motord.bus.messages.from_snapshot import Body, Commander


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """What is known at one moment: the newest snapshot, and what the daemon said last."""

    snapshot: Snapshot
    status: Mapping[str, Any] | None = None
    """Of the local socket; None: not asked yet, or no answer."""
    status_ns: int = 0
    """When it was asked for, CLOCK_MONOTONIC."""

    def battery(self) -> Mapping[str, Any] | None:
        """As the daemon's status has it. None: no [battery], or the daemon has not said yet."""
        return (self.status or {}).get("battery")

    def why(self) -> tuple[str, ...]:
        """What led to the faults that are latched. Empty: none is, or the daemon has not said."""
        return tuple((self.status or {}).get("why", ())) if self.snapshot.faults else ()

    def commander(self) -> Commander | None:
        """Who holds the lease that commands. None: nobody, or the daemon has not said yet."""
        for lease in (self.status or {}).get("leases", ()):
            if lease["number"] == self.snapshot.owner:
                return Commander(owner=lease["owner"], priority=lease["priority"], why=lease["why"])
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """One name of the tree. `build` gives the message, or None where there is none to be had."""

    name: str
    type_name: str
    """ROS 2's; our own types are of the package motord_msgs."""
    message: type
    """The dataclass of what is built."""
    build: Callable[[View, Body, int], Any]


def _loop_statistics(view: View, _: Body, wall_offset_ns: int) -> Any:
    if view.status is None:
        return None
    return messages.loop_statistics(view.status["loop"], view.status_ns, wall_offset_ns)


_ALL = (
    Topic(
        name="odom",
        type_name="nav_msgs/msg/Odometry",
        message=message_types.Odometry,
        build=lambda view, body, offset_ns: messages.odometry(view.snapshot, body, offset_ns),
    ),
    Topic(
        name="tf",
        type_name="tf2_msgs/msg/TFMessage",
        message=message_types.TFMessage,
        build=lambda view, body, offset_ns: messages.transforms(view.snapshot, body, offset_ns),
    ),
    Topic(
        name="joint_states",
        type_name="sensor_msgs/msg/JointState",
        message=message_types.JointState,
        build=lambda view, body, offset_ns: messages.joint_state(view.snapshot, body, offset_ns),
    ),
    Topic(
        name="imu",
        type_name="sensor_msgs/msg/Imu",
        message=message_types.Imu,
        build=lambda view, body, offset_ns: messages.imu(view.snapshot, body, offset_ns),
    ),
    Topic(
        name="battery_state",
        type_name="sensor_msgs/msg/BatteryState",
        message=message_types.BatteryState,
        build=lambda view, _, offset_ns: messages.battery_state(
            view.snapshot, offset_ns, view.battery()
        ),
    ),
    Topic(
        name="diagnostics",
        type_name="diagnostic_msgs/msg/DiagnosticArray",
        message=message_types.DiagnosticArray,
        build=lambda view, body, offset_ns: messages.diagnostics(
            view.snapshot, body, offset_ns, view.battery()
        ),
    ),
    Topic(
        name="motor_status",
        type_name="motord_msgs/msg/MotorStatus",
        message=message_types.MotorStatus,
        build=lambda view, body, offset_ns: messages.motor_status(
            view.snapshot, body, offset_ns, view.commander(), view.why()
        ),
    ),
    Topic(
        name="loop_statistics",
        type_name="motord_msgs/msg/LoopStatistics",
        message=message_types.LoopStatistics,
        build=_loop_statistics,
    ),
)
TOPICS = MappingProxyType({topic.name: topic for topic in _ALL})
"""By name."""


def wall_offset_ns() -> int:
    """CLOCK_REALTIME less CLOCK_MONOTONIC, now: what turns a sample's stamp into wall time."""
    return time.time_ns() - time.monotonic_ns()
