# SPDX-License-Identifier: Apache-2.0
"""Names as ROS 2 middleware writes them on DDS (design.ros2.org, "Topic and Service name mapping to
DDS")."""

from __future__ import annotations

from collections.abc import Mapping

GRAPH_TOPIC = "ros_discovery_info"
"""DDS topic of the graph, which has no prefix (rmw_dds_common)."""
_OF_HUMBLE = "_humble"
"""Suffix of motord's name for a package whose types differ in Humble; on DDS the names are the
same."""


def dds_type(name: str) -> str:
    """Return the name of a type on DDS: nav_msgs::msg::dds_::Odometry_ for
    nav_msgs/msg/Odometry."""
    package, group, short = name.split("/")
    package = package.removesuffix(_OF_HUMBLE)
    return f"{package}::{group}::dds_::{short}_"


def full_name(namespace: str, node: str, name: str) -> str:
    """Return a topic's or service's name with its namespace: `/x` stays, `~/x` is below the
    node."""
    if name.startswith("/"):
        return name
    below = f"{namespace.rstrip('/')}/"
    return f"{below}{node}/{name[2:]}" if name.startswith("~/") else below + name


def remapped(namespace: str, node: str, name: str, rules: Mapping[str, str]) -> str:
    """Return the full name, or the full name that a rule replaces it by. Both sides of a rule may
    be relative, absolute or private names (design.ros2.org, "Remapping Names")."""
    full = full_name(namespace, node, name)
    for old, new in rules.items():
        if full_name(namespace, node, old) == full:
            return full_name(namespace, node, new)
    return full


def topic(name: str) -> str:
    """Return the DDS topic of a topic: rt/odom for /odom."""
    return f"rt{name}"


def request(name: str) -> str:
    """Return the DDS topic of a service's requests: rq/armRequest for /arm."""
    return f"rq{name}Request"


def reply(name: str) -> str:
    """Return the DDS topic of a service's replies: rr/armReply for /arm."""
    return f"rr{name}Reply"
