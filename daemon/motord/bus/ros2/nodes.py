# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes of the second process. Sections of the robot file with the same node settings
share one node. Publishers and inputs are the same on DDS and on Zenoh."""

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
        """Send a message without waiting; a message that the middleware does not take is lost."""
        ...


class Node(Protocol):
    """A ROS 2 node. Create its topics and services before `run`; that may raise DdsError."""

    remap: dict[str, str]
    """New names of topics and services by their old ones, from all sections that share the node so
    far."""

    def full(self, name: str) -> str:
        """Return a name with its namespace, replaced by the rules in `remap`."""
        ...

    def publisher(self, name: str, kind: str, quality: Quality | None = None) -> TopicPublisher:
        """Create a publisher. `kind`: a type of `table.TYPES`."""
        ...

    def subscribe(self, name: str, kind: str, take: Take, quality: Quality | None = None) -> None:
        """Subscribe to a topic. `take` is called in the event loop for each message."""
        ...

    def serve(
        self, name: str, kind: str, answer: Answer, depth: int = 10, together: int = 1
    ) -> None:
        """Offer a service. `kind`: pkg/srv/Name. `together`: largest number of answers in progress
        at once."""
        ...

    async def run(self) -> None:
        """Run the node until cancelled. When several adapters share the node, one of them runs it
        for all; if that one fails, the next one does."""
        ...


class _OwnNode(Node, TypedNode, Protocol):
    """A node that needs no installed ROS 2, and so describes its types itself."""


_Key = tuple[type, str, str, int]
_nodes: WeakKeyDictionary[Runtime, dict[_Key, _OwnNode]] = WeakKeyDictionary()


def node_of(runtime: Runtime, section: Ros2Node | ZenohNode) -> Node:
    """Return the node of a section; create it at the first call. Raises DdsError, ValueError if
    Zenoh rejects the router's settings, and ImportError if the middleware's package is missing."""
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
    """Create the node. Only the middleware that the robot file names is imported."""
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
