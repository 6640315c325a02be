# SPDX-License-Identifier: Apache-2.0
"""Keys, tokens and attachments by which rmw_zenoh 0.2.x (Jazzy) and later recognise a ROS 2 node on
Zenoh (docs/design.md of rmw_zenoh). A liveliness token announces an endpoint and describes it
completely."""

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
"""Text that rmw_zenoh of Humble writes in place of a type's hash."""
_ATTACHMENT = struct.Struct("<qqB16s")


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeNames:
    """The parts that every token of a node contains."""

    domain_id: int
    session_id: str
    namespace: str
    """Namespace of the node, with a slash at its beginning."""
    name: str
    hashed: bool = True
    """Whether types have a hash, as in Iron and later."""

    def token(self) -> str:
        """Return the token of the node itself. The session has no other node, so the node's number
        and its entity number are 0."""
        return self._token(0, NODE)

    def endpoint_token(self, number: int, what: str, topic: str, kind: str, quality: str) -> str:
        """Return the token of an endpoint. `number`: the endpoint's number in its node. `what`:
        PUBLISHER, SUBSCRIPTION or SERVER. `topic`: full name of the topic or service."""
        topic_text = f"{_mangled(topic)}/{dds_type(kind)}/{self._hash(kind)}/{quality}"
        return f"{self._token(number, what)}/{topic_text}"

    def any_publisher(self, topic: str) -> str:
        """Return a key expression for the tokens of all publishers of a topic, whatever their
        type."""
        return f"{_SPACE}/{self.domain_id}/*/*/*/{PUBLISHER}/*/*/*/{_mangled(topic)}/*/*/*"

    def key(self, topic: str, kind: str) -> str:
        """Return the Zenoh key of a topic's messages, or of a service's requests."""
        return f"{self.domain_id}/{topic.strip('/')}/{dds_type(kind)}/{self._hash(kind)}"

    def _hash(self, kind: str) -> str:
        return type_hash(kind) if self.hashed else _NO_HASH

    def _token(self, number: int, what: str) -> str:
        head = f"{_SPACE}/{self.domain_id}/{self.session_id}/0/{number}/{what}"
        return f"{head}/%/{_mangled(self.namespace)}/{self.name}"


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def quality_text(*, depth: int, reliable: bool, latched: bool) -> str:
    """Return the quality of service as a token contains it: reliability, durability, history,
    deadline, lifespan and liveliness. Defaults of rmw_zenoh are left out; numbers are those of
    rmw/types.h."""
    depth_text = "" if depth == _DEPTH_DEFAULT else str(depth)
    return f"{'' if reliable else 2}:{1 if latched else ''}:,{depth_text}:,:,:,,"


def type_of(token: str) -> str:
    """Return the type of the topic that an endpoint's token announces, as `dds_type` writes it."""
    return token.split("/")[_TYPE_PLACE]


def node_of(token: str) -> str:
    """Return the full name of the node whose endpoint a token announces."""
    namespace, name = token.split("/")[_NODE_PLACES]
    return f"{namespace.replace('%', '/').rstrip('/')}/{name}"


def gid(token: str) -> bytes:
    """Return the gid of the endpoint that a token announces: the 128-bit XXH3 of the token, lower
    half first."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


@dataclass(frozen=True, slots=True)
class Attachment:
    """The attachment of every message, request and reply."""

    sequence: int
    stamp_ns: int
    """Time of sending, CLOCK_REALTIME."""
    gid: bytes

    def encode(self) -> bytes:
        """Return the attachment as rmw_zenoh 0.2 and later write it."""
        return _ATTACHMENT.pack(self.sequence, self.stamp_ns, len(self.gid), self.gid)

    @classmethod
    def decode(cls, raw: bytes) -> Attachment:
        """Return the attachment that `raw` contains. Raises ValueError if it contains no
        attachment."""
        try:
            sequence, stamp_ns, length, number = _ATTACHMENT.unpack(raw)
        except struct.error as error:
            raise ValueError(f"no attachment of rmw_zenoh: {error}") from error
        if length != len(number):
            raise ValueError(f"no attachment of rmw_zenoh: a gid of {length} bytes")
        return cls(sequence, stamp_ns, number)
