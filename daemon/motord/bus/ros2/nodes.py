# SPDX-License-Identifier: Apache-2.0
"""The nodes of the second process: sections of the robot file with the same settings share one.
Publishers and inputs are the same on DDS and on Zenoh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol
from weakref import WeakKeyDictionary

from motord.bus.ros2.quality import Answer, Quality, Take
from motord.bus.ros2.services.type_description import TypedNode, serve_types

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime
    from motord.config import Ros2Node, ZenohNode


class TopicPublisher(Protocol):
    """A topic that is published."""

    def publish(self, message: Any) -> None:
        """Never waits; what is not taken is lost."""
        ...


class Node(Protocol):
    """Topics and services are made before `run`. Each may raise DdsError."""

    remap: dict[str, str]
    """Names that are others here: those of the sections that have come so far."""

    def full(self, name: str) -> str:
        """A name with its namespace, as `remap` has it."""
        ...

    def publisher(self, name: str, kind: str, quality: Quality | None = None) -> TopicPublisher:
        """Of a type of `table.TYPES`."""
        ...

    def subscribe(self, name: str, kind: str, take: Take, quality: Quality | None = None) -> None:
        """`take` is called in the event loop."""
        ...

    def serve(
        self, name: str, kind: str, answer: Answer, depth: int = 10, together: int = 1
    ) -> None:
        """A service, of pkg/srv/Name; so many answers at once."""
        ...

    async def run(self) -> None:
        """Until cancelled. Of several that share the node one does it for all, and the next one
        when that one fails."""
        ...


class _OwnNode(Node, TypedNode, Protocol):
    """A node without an installed ROS 2, which would describe its types itself."""


_Key = tuple[type, str, str, int]
_nodes: WeakKeyDictionary[Runtime, dict[_Key, _OwnNode]] = WeakKeyDictionary()


def node_of(runtime: Runtime, section: Ros2Node | ZenohNode) -> Node:
    """Made when first asked for. Raises DdsError, ValueError for a router that cannot be, and
    ImportError where the middleware's package is missing."""
    nodes = _nodes.setdefault(runtime, {})
    from motord.config import Ros2Node, ZenohNode  # not needed where the node is made elsewhere

    over = ZenohNode if isinstance(section, ZenohNode) else Ros2Node
    key = (over, section.node_name, section.namespace, section.domain_id)
    fresh = key not in nodes
    if fresh:
        nodes[key] = _made(runtime, section)
    nodes[key].remap.update(section.remap)
    if fresh:
        serve_types(nodes[key])
    return nodes[key]


def _made(runtime: Runtime, section: Ros2Node | ZenohNode) -> _OwnNode:
    """A robot loads only the middleware that it has."""
    names = (section.node_name, section.namespace, section.domain_id)
    from motord.config import Ros2Node

    if isinstance(section, Ros2Node):
        from motord.bus.ros2.dds import node

        return node.Node(*names, section.discovery, section.interface, section.distribution)
    from motord.bus.ros2.zenoh import node as zenoh_node

    def path(name: str | None) -> str | None:
        return None if name is None else str(runtime.beside_robot_file(name))

    router = zenoh_node.Router(
        endpoint=section.router,
        ca_file=path(section.ca_file),
        cert_file=path(section.cert_file),
        key_file=path(section.key_file),
    )
    return zenoh_node.ZenohNode(*names, router, section.distribution)
