# SPDX-License-Identifier: Apache-2.0
"""ROS 2 types as data, and the hash by which both ends of a topic compare their types (REP-2011,
RIHS01: SHA-256 of the type's description as JSON, comments and defaults left out)."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any

from motord.bus.messages.definitions import ACTIONS, COMMON, GRAPH, OWN, SERVICES
from motord.bus.messages.description import DESCRIPTIONS

# type_description_interfaces/msg/FieldType
_IDS = {
    "int8": 2,
    "uint8": 3,
    "char": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
_NESTED, _BOUNDED_STRING = 1, 21
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
PLACEHOLDER = "structure_needs_at_least_one_member"
"""The field that rosidl gives to a type without fields."""
_FIELD = re.compile(r"([\w/]+)(?:<=(\d+))?(?:\[(<=)?(\d*)\])? (\w+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A field of a type. `count`: None: a single value; 0: any number of values; otherwise at most
    so many values if `bounded`, else exactly so many."""

    name: str
    kind: str
    """Type of the value: a primitive, or the full name of a type."""
    count: int | None = None
    bounded: bool = False
    chars_max: int = 0
    """Largest length of a string; 0: any length."""

    @property
    def primitive(self) -> bool:
        """Whether the field has a primitive type."""
        return self.kind in _IDS

    @property
    def sequence(self) -> bool:
        """Whether the number of values is part of the message."""
        return self.count is not None and (self.count == 0 or self.bounded)


def _parsed(text: str) -> Iterator[tuple[str, tuple[Field, ...]]]:
    for block in text.split("=== ")[1:]:
        name, *lines = block.strip().splitlines()
        fields = tuple(_field(line, name.split("/")[0]) for line in lines)
        yield name, fields or (Field(name=PLACEHOLDER, kind="uint8"),)


def _field(line: str, package: str) -> Field:
    match = _FIELD.fullmatch(line)
    assert match, line
    kind, chars_max, bounded, count, name = match.groups()
    if kind not in _IDS:
        package, _, kind = f"{package}/{kind}".rpartition("/")
        kind = f"{package.split('/')[-1]}/msg/{kind}"
    return Field(
        name=name,
        kind=kind,
        count=None if count is None else int(count or 0),
        bounded=bounded is not None,
        chars_max=int(chars_max or 0),
    )


_EVENT_INFO = "service_msgs/msg/ServiceEventInfo"


def _services(messages: Iterable[str]) -> Iterator[tuple[str, tuple[Field, ...]]]:
    """Yield for each service the type whose hash it has on Zenoh, of request, response and event,
    and the event of service introspection (rosidl_generator_type_description)."""
    for name in messages:
        service, ending, rest = name.partition("_Request")
        if ending and not rest:
            yield (
                f"{service}_Event",
                (
                    Field(name="info", kind=_EVENT_INFO),
                    Field(name="request", kind=name, count=1, bounded=True),
                    Field(name="response", kind=f"{service}_Response", count=1, bounded=True),
                ),
            )
            yield (
                service,
                (
                    Field(name="request_message", kind=name),
                    Field(name="response_message", kind=f"{service}_Response"),
                    Field(name="event_message", kind=f"{service}_Event"),
                ),
            )


def _actions(messages: Iterable[str]) -> Iterator[tuple[str, tuple[Field, ...]]]:
    """Yield the types that an action's client and server exchange: two services and the feedback
    topic (rosidl_parser, ACTION_* in its definition.py)."""
    goal_id = Field(name="goal_id", kind="unique_identifier_msgs/msg/UUID")
    for name in messages:
        action, ending, rest = name.partition("_Goal")
        if "/action/" not in name or not ending or rest:
            continue
        goal = Field(name="goal", kind=name)
        accepted = Field(name="accepted", kind="bool")
        stamp = Field(name="stamp", kind="builtin_interfaces/msg/Time")
        status = Field(name="status", kind="int8")
        result = Field(name="result", kind=f"{action}_Result")
        feedback = Field(name="feedback", kind=f"{action}_Feedback")
        yield f"{action}_SendGoal_Request", (goal_id, goal)
        yield f"{action}_SendGoal_Response", (accepted, stamp)
        yield f"{action}_GetResult_Request", (goal_id,)
        yield f"{action}_GetResult_Response", (status, result)
        yield f"{action}_FeedbackMessage", (goal_id, feedback)


_PUBLISHED = "".join(described.definition() for described in DESCRIPTIONS.values())
_DEFINED = dict(_parsed(COMMON + OWN + _PUBLISHED + SERVICES + ACTIONS + GRAPH))
_MESSAGES = _DEFINED | dict(_actions(_DEFINED))
TYPES = MappingProxyType(_MESSAGES | dict(_services(_MESSAGES)))
"""Fields by the type's name."""


def definition(name: str) -> str:
    """Return a type and all its parts in .msg notation, as MCAP and Foxglove expect it."""
    separator = "=" * 80
    return message_definition(name) + "".join(
        f"{separator}\nMSG: {other.replace('/msg/', '/')}\n{message_definition(other)}"
        for other in made_of(name)
    )


def message_definition(name: str) -> str:
    """Return the text of NAME.msg."""
    return "".join(f"{_line(field)}\n" for field in TYPES[name])


def action_definition(name: str) -> str:
    """Return the text of NAME.action: goal, result and feedback."""
    parts = (f"{name}_{part}" for part in ("Goal", "Result", "Feedback"))
    return "---\n".join(map(message_definition, parts))


def _line(field: Field) -> str:
    bound = f"<={field.chars_max}" if field.chars_max else ""
    count = "" if field.count is None else f"[{'<=' * field.bounded}{field.count or ''}]"
    return f"{field.kind.replace('/msg/', '/')}{bound}{count} {field.name}"


def made_of(name: str) -> list[str]:
    """Return every type that a type needs, sorted."""
    found: set[str] = set()
    todo = [name]
    while todo:
        for field in TYPES[todo.pop()]:
            if not field.primitive and field.kind not in found:
                found.add(field.kind)
                todo.append(field.kind)
    return sorted(found)


def description(name: str) -> dict[str, Any]:
    """Return a type's description in the form of type_description_interfaces/TypeDescription,
    without default values. Raises KeyError for a type that is not known."""
    return {
        "type_description": _described(name),
        "referenced_type_descriptions": [_described(other) for other in made_of(name)],
    }


@cache
def type_hash(name: str) -> str:
    """Return a type's hash: `RIHS01_` and 64 hexadecimal digits. Raises KeyError for a type that is
    not known."""
    text = json.dumps(description(name), separators=(", ", ": "))
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def _described(name: str) -> dict[str, Any]:
    fields = [{"name": field.name, "type": _type_of(field)} for field in TYPES[name]]
    return {"type_name": name, "fields": fields}


def _type_of(field: Field) -> dict[str, Any]:
    number = _IDS.get(field.kind, _NESTED)
    if field.chars_max:
        number = _BOUNDED_STRING
    if field.sequence:
        number += _BOUNDED_SEQUENCE if field.bounded else _SEQUENCE
    elif field.count is not None:
        number += _ARRAY
    return {
        "type_id": number,
        "capacity": field.count or 0,
        "string_capacity": field.chars_max,
        "nested_type_name": "" if field.primitive else field.kind,
    }


def with_parts(service: str) -> tuple[str, str, str]:
    """Return the names of a service, its request and its reply."""
    return service, f"{service}_Request", f"{service}_Response"
