# SPDX-License-Identifier: Apache-2.0
"""The service ~/get_type_description, which describes a type of the node by its hash (REP-2011).
Tools call it for types that they were not built with."""

from __future__ import annotations

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, Protocol

from motord.bus.messages.table import (
    PLACEHOLDER,
    TYPES,
    description,
    made_of,
    message_definition,
    type_hash,
    with_parts,
)
from motord.bus.ros2.quality import Answer

SERVICE = "type_description_interfaces/srv/GetTypeDescription"
_HASH_CHARS = 80
_NOTHING = {
    "type_description": {"type_name": "", "fields": ()},
    "referenced_type_descriptions": (),
}


class TypedNode(Protocol):
    """The part of a node that this service needs."""

    types: set[str]
    """Types of the node's topics and services."""

    def serve(self, name: str, kind: str, answer: Answer) -> None:
        """Offer a service: see `nodes.Node.serve`."""
        ...


def serve_types(node: TypedNode) -> None:
    """Offer the service on a node. It describes the types that the node's endpoints have when a
    request arrives. Raises DdsError."""

    async def answer(request: SimpleNamespace) -> SimpleNamespace:
        # The hash alone decides, as in rcl: the name is part of what is hashed.
        for name in node.types:
            if type_hash(name) == request.type_hash:
                sources = _sources(name) if request.include_type_sources else ()
                return _reply(description(name), "", sources)
        reason = f"no type of this node has the hash {request.type_hash[:_HASH_CHARS]!r}"
        return _reply(_NOTHING, reason, ())

    node.serve("~/get_type_description", SERVICE, answer)


def _reply(found: dict[str, Any], reason: str, sources: Iterable[Any]) -> SimpleNamespace:
    return SimpleNamespace(
        successful=not reason,
        failure_reason=reason,
        type_description=SimpleNamespace(
            type_description=_individual(found["type_description"]),
            referenced_type_descriptions=[
                _individual(other) for other in found["referenced_type_descriptions"]
            ],
        ),
        type_sources=list(sources),
        extra_information=(),
    )


def _individual(found: dict[str, Any]) -> SimpleNamespace:
    return SimpleNamespace(
        type_name=found["type_name"],
        fields=[
            SimpleNamespace(
                name=field["name"], type=SimpleNamespace(**field["type"]), default_value=""
            )
            for field in found["fields"]
        ],
    )


def _sources(name: str) -> list[SimpleNamespace]:
    """Return the sources of a type and its parts. Sources of types that others define have no
    comments."""
    return [_source(one) for one in (name, *made_of(name))]


def _source(name: str) -> SimpleNamespace:
    """Return the source of a type. The encoding is `implicit`, without a text, for types that
    rosidl generates from a service or an action."""
    encoding, text = "implicit", ""
    if "/msg/" in name:
        encoding, text = "msg", _text(name)
    elif "/srv/" in name and all(part in TYPES for part in with_parts(name)):
        _, *parts = with_parts(name)
        encoding, text = "srv", "---\n".join(map(_text, parts))
    return SimpleNamespace(type_name=name, encoding=encoding, raw_file_contents=text)


def _text(name: str) -> str:
    """Return a type's definition as its author wrote it: empty for a type without fields."""
    lonely = [field.name for field in TYPES[name]] == [PLACEHOLDER]
    return "" if lonely else message_definition(name)
