# SPDX-License-Identifier: Apache-2.0
"""Names as ROS 2 middleware writes them on DDS (design.ros2.org, "Topic and Service name mapping to
DDS"; REP-2011 for the hash)."""

from __future__ import annotations

from collections.abc import Mapping

GRAPH_TOPIC = "ros_discovery_info"
"""Without a prefix: rmw_dds_common."""
_OF_HUMBLE = "_humble"
"""Ends our name of a package whose types were others in Humble; on DDS they have the same name."""


def dds_type(name: str) -> str:
    """nav_msgs/msg/Odometry: nav_msgs::msg::dds_::Odometry_"""
    package, group, short = name.split("/")
    package = package.removesuffix(_OF_HUMBLE)
    return f"{package}::{group}::dds_::{short}_"


def full_name(namespace: str, node: str, name: str) -> str:
    """A topic's or service's name with its namespace: `/x` stays, `~/x` is below the node."""
    if name.startswith("/"):
        return name
    below = f"{namespace.rstrip('/')}/"
    return f"{below}{node}/{name[2:]}" if name.startswith("~/") else below + name


def remapped(namespace: str, node: str, name: str, rules: Mapping[str, str]) -> str:
    """The full name, or the one that a rule has for it; both sides of a rule are names as any
    (design.ros2.org, "Remapping Names")."""
    full = full_name(namespace, node, name)
    for old, new in rules.items():
        if full_name(namespace, node, old) == full:
            return full_name(namespace, node, new)
    return full


def topic(name: str) -> str:
    """/odom: rt/odom"""
    return f"rt{name}"


def request(name: str) -> str:
    """/arm: rq/armRequest"""
    return f"rq{name}Request"


def reply(name: str) -> str:
    """/arm: rr/armReply"""
    return f"rr{name}Reply"
