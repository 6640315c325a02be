# SPDX-License-Identifier: Apache-2.0
"""Keys, tokens and attachments by which rmw_zenoh 0.2.x (Jazzy) and later know a ROS 2 node on
Zenoh: its docs/design.md. A liveliness token, which contains all of it, announces an endpoint."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import xxhash

from motord.bus.messages.table import type_hash
from motord.bus.ros2.names import dds_type

NODE, PUBLISHER, SUBSCRIPTION, SERVER = "NN", "MP", "MS", "SS"
_SPACE = "@ros2_lv"
_DEPTH_DEFAULT = 42
_TYPE_PLACE, _NODE_PLACES = 10, slice(7, 9)
_NO_HASH = "TypeHashNotSupported"
"""What rmw_zenoh of Humble writes in its place."""
_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeNames:
    """What every token of a node contains."""

    domain_id: int
    session_id: str
    namespace: str
    """With a slash at its beginning."""
    name: str
    hashed: bool = True
    """Types have a hash: Iron and later."""

    def token(self) -> str:
        """Of the node itself; it is the session's only one, and its own entity."""
        return self._token(0, NODE)

    def endpoint_token(self, number: int, what: str, topic: str, kind: str, quality: str) -> str:
        """Of a topic or service by its full name; `number` is the endpoint's in its node."""
        topic_text = f"{_mangled(topic)}/{dds_type(kind)}/{self._hash(kind)}/{quality}"
        return f"{self._token(number, what)}/{topic_text}"

    def any_publisher(self, topic: str) -> str:
        """The tokens of the publishers of a topic, of whatever type, as a key expression."""
        return f"{_SPACE}/{self.domain_id}/*/*/*/{PUBLISHER}/*/*/*/{_mangled(topic)}/*/*/*"

    def key(self, topic: str, kind: str) -> str:
        """Where a topic's messages, or a service's requests, go."""
        return f"{self.domain_id}/{topic.strip('/')}/{dds_type(kind)}/{self._hash(kind)}"

    def _hash(self, kind: str) -> str:
        return type_hash(kind) if self.hashed else _NO_HASH

    def _token(self, number: int, what: str) -> str:
        head = f"{_SPACE}/{self.domain_id}/{self.session_id}/0/{number}/{what}"
        return f"{head}/%/{_mangled(self.namespace)}/{self.name}"


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def quality_text(*, depth: int, reliable: bool, latched: bool) -> str:
    """Reliability, durability, history, deadline, lifespan and liveliness; what is rmw_zenoh's
    default is left out. Numbers are those of rmw/types.h."""
    depth_text = "" if depth == _DEPTH_DEFAULT else str(depth)
    return f"{'' if reliable else 2}:{1 if latched else ''}:,{depth_text}:,:,:,,"


def type_of(token: str) -> str:
    """Of the topic that an endpoint's token announces, as `dds_type`."""
    return token.split("/")[_TYPE_PLACE]


def node_of(token: str) -> str:
    """Full name of the node whose endpoint a token announces."""
    namespace, name = token.split("/")[_NODE_PLACES]
    return f"{namespace.replace('%', '/').rstrip('/')}/{name}"


def gid(token: str) -> bytes:
    """Of the endpoint that a token announces: XXH3 of it, 128 bits, the lower half first."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


@dataclass(frozen=True, slots=True)
class Attachment:
    """What goes with every message, request and reply."""

    sequence: int
    stamp_ns: int
    """CLOCK_REALTIME of the sending."""
    gid: bytes

    def encode(self) -> bytes:
        """As rmw_zenoh 0.2 and later have it."""
        return _ATTACHMENT.pack(self.sequence, self.stamp_ns, len(self.gid), self.gid)

    @classmethod
    def decode(cls, raw: bytes) -> Attachment:
        """Raises ValueError."""
        try:
            sequence, stamp_ns, length, number = _ATTACHMENT.unpack(raw)
        except struct.error as error:
            raise ValueError(f"no attachment of rmw_zenoh: {error}") from error
        if length != len(number):
            raise ValueError(f"no attachment of rmw_zenoh: a gid of {length} bytes")
        return cls(sequence, stamp_ns, number)
