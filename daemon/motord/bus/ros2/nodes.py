# SPDX-License-Identifier: Apache-2.0
"""The nodes of the second process: sections of the robot file that say the same share one."""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from motord.bus.ros2.node import Node
from motord.config import Ros2Node

if TYPE_CHECKING:
    from motord.bus.station import Station

_nodes: WeakKeyDictionary[Station, dict[tuple[str, str, int], Node]] = WeakKeyDictionary()


def node_of(station: Station, section: Ros2Node) -> Node:
    """Made when first asked for. Raises DdsError."""
    nodes = _nodes.setdefault(station, {})
    key = (section.node_name, section.namespace, section.domain_id)
    if key not in nodes:
        nodes[key] = Node(*key, section.discovery, section.interface)
    return nodes[key]
