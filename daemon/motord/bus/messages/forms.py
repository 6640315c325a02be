# SPDX-License-Identifier: Apache-2.0
"""Makes messages from a view, in the form that a bus takes: a dictionary, JSON or CDR. The
functions are compiled from the descriptions of `motord.bus.messages.tree` when a feed is made.

A form returns a function for a topic and a body. That function takes a view and the wall clock's
offset at the moment of the stamp. It returns None if there is no message, and raises ValueError for
values that do not fit.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

from motord.bus.messages import cdr, json_form
from motord.bus.messages.description import DESCRIPTIONS, Description
from motord.bus.messages.layout import (
    EXPRESSIONS,
    TIME,
    Block,
    Constant,
    Fixed,
    Item,
    Open,
    items,
    per_joint,
    zero,
)
from motord.bus.messages.sources import Body, all_joints
from motord.bus.messages.table import TYPES
from motord.bus.messages.topics import Topic, View

Make = Callable[[View, int], Any]
Form = Callable[[Topic, Body], Make]
_NS = 1_000_000_000
_STAMP = struct.Struct("<iI")
_STAMP_OFFSETS = {"tf": 8}
"""Offsets of the stamp in bytes, by topics in which it is not the first field."""
_SETS_OF_JOINTS_MAX = 64


def as_message(topic: Topic, body: Body) -> Make:
    """Return the function that makes the fields of the type as a dictionary."""
    described = DESCRIPTIONS[topic.name]
    literal = _literal(described, described.type_name, "")
    built = _compiled(described, f"return {literal}", {})
    return _chosen(described, body, lambda _: built)


def as_json(topic: Topic, body: Body) -> Make:
    """Return the function that makes JSON, without a line end. Numbers that are not finite become
    null."""
    build = as_message(topic, body)

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        message = build(view, wall_offset_ns)
        return None if message is None else json_form.encode(message)

    return encoded


def as_cdr(topic: Topic, body: Body) -> Make:
    """Return the function that makes plain CDR with its header, as ROS 2 reads it."""
    described = DESCRIPTIONS[topic.name]
    return _chosen(described, body, lambda names: _cdr_encoder(described, body, names))


def measured_ns(topic: Topic, body: Body) -> Callable[[View], int | None]:
    """Return the function that returns the moment of CLOCK_MONOTONIC which the stamp of the topic's
    message means; None if there is no message. It raises ValueError as the forms do."""
    described = DESCRIPTIONS[topic.name]
    built = _compiled(described, "return moment_ns", {})
    make = _chosen(described, body, lambda _: built)
    return lambda view: make(view, 0)


def stamp_ns(topic: str, raw: bytes) -> int:
    """Return the stamp in a CDR message of that topic, as wall time."""
    sec, nanosec = _STAMP.unpack_from(raw, _STAMP_OFFSETS.get(topic, len(cdr.HEADER)))
    return int(sec * _NS + nanosec)


def _chosen(
    described: Description, body: Body, made_for: Callable[[Sequence[str]], Callable[..., Any]]
) -> Make:
    """Return a function that passes the names and values of the message's joints to a function of
    `made_for`."""
    if not described.names_joints:
        make = made_for(())
        return lambda view, wall_offset_ns: make(view, body, wall_offset_ns, (), ())
    if not described.joints:
        return _of_all_joints(body, made_for(body.joints))
    choose = eval(f"lambda now, body: {described.joints}", dict(EXPRESSIONS))
    kept: dict[Sequence[str], Callable[..., Any]] = {}

    def made(view: View, wall_offset_ns: int) -> Any:
        names, joints = choose(view.snapshot, body)
        make = kept.get(names)
        if make is None:
            if len(kept) >= _SETS_OF_JOINTS_MAX:
                kept.clear()
            make = kept[names] = made_for(names)
        return make(view, body, wall_offset_ns, names, joints)

    return made


def _of_all_joints(body: Body, make: Callable[..., Any]) -> Make:
    names, count = body.joints, len(body.joints)

    def made(view: View, wall_offset_ns: int) -> Any:
        joints = view.snapshot.joints
        if len(joints) != count:
            all_joints(view.snapshot, body)
        return make(view, body, wall_offset_ns, names, joints)

    return made


def _compiled(described: Description, last: str, names: dict[str, Any]) -> Callable[..., Any]:
    """Compile a function of view, body, offset, names and joints: the description's steps, its
    stamp, and then `last`. Its text comes from the tree and the number of joints alone, never from
    a robot file."""
    (stamp,) = (row.source for row in described.rows if row.path.endswith(".stamp"))
    steps = {"let": "{}", "needs": "if not ({}): return None"}
    lines = [
        "now = view.snapshot",
        *(steps[word].format(text) for word, text in described.steps),
        f"moment_ns = {stamp} + wall_offset_ns",
        f"sec = moment_ns // {_NS}",
        f"nanosec = moment_ns - sec * {_NS}",
        last,
    ]
    body = "".join(f"  {line}\n" for line in lines)
    source = (
        "def made(view, body, wall_offset_ns, names, joints):\n try:\n" + body +
        " except (struct_error, OverflowError) as error:\n"
        f"  raise ValueError(f'{described.type_name}: {{error}}') from error\n"
    )  # fmt: skip
    known = {**EXPRESSIONS, **names, "struct_error": struct.error}
    exec(source, known)  # noqa: S102  text of the tree
    made: Callable[..., Any] = known["made"]
    return made


def _literal(described: Description, type_name: str, prefix: str) -> str:
    """Return the dictionary of a type, as Python text."""
    rows = {row.path: row for row in described.rows}
    parts = []
    for field in TYPES[type_name]:
        path = prefix + field.name
        source = rows[path].source if path in rows else ""
        if source and field.kind == TIME:
            value = "{'sec': sec, 'nanosec': nanosec}"
        elif source and per_joint(source):
            value = f"[{source} for joint in joints]"
        elif source or field.primitive:
            value = source or repr(zero(field))
        elif field.count is None:
            value = _literal(described, field.kind, f"{path}.")
        elif any(row.startswith(f"{path}[0].") for row in rows):
            value = f"[{_literal(described, field.kind, f'{path}[0].')}]"
        else:
            value = "[]"
        parts.append(f"{field.name!r}: {value}")
    return f"{{{', '.join(parts)}}}"


def _cdr_encoder(described: Description, body: Body, names: Sequence[str]) -> Callable[..., Any]:
    """Return the function that makes CDR. Values of known sizes are packed at once. Those from the
    first to the last of unknown size are mostly words: they are laid out again only when one of
    them changes."""
    found = items(described, body, names)
    places = [place for place, item in enumerate(found) if isinstance(item, Open)]
    begin, end = (places[0], places[-1] + 1) if places else (len(found), len(found))
    head = Block(_closed(found[:begin]), 0, cdr.HEADER)
    unpacked = "".join(f"joint_{place}, " for place in range(len(names)))
    prologue = f"{unpacked}= joints\n  " if unpacked else ""
    known: dict[str, Any] = {"pack": head.struct(last=not places).pack}
    known |= {f"CONSTANT_{place}": raw for place, raw in enumerate(head.constants)}
    if not places:
        return _compiled(described, f"{prologue}return pack({', '.join(head.arguments)})", known)
    known["words"] = _Words(found[begin:end], found[end:], head.end)
    values = [item.source for item in found[begin:end] if not isinstance(item, Constant)]
    rest = [item.source for item in found[end:] if isinstance(item, Fixed)]
    return _compiled(
        described,
        f"{prologue}values = ({', '.join(values)},)\n"
        "  laid_out, pack_rest = words.kept if values == words.values else words.lay_out(values)\n"
        f"  return pack({', '.join(head.arguments)}) + laid_out + pack_rest({', '.join(rest)})",
        known,
    )


def _closed(found: Sequence[Item]) -> list[Constant | Fixed]:
    """Return the values of known sizes."""
    return [item for item in found if not isinstance(item, Open)]


class _Words:
    """The part of a message that has no fixed length, and the values after it."""

    def __init__(self, words: Sequence[Item], rest: Sequence[Item], at: int) -> None:
        self._words, self._rest, self._at = words, rest, at
        self._packs: dict[int, Callable[..., bytes]] = {}
        self.values: tuple[Any, ...] | None = None
        self.kept: tuple[bytes, Callable[..., bytes]]
        """The bytes of `values`, and the function that packs the rest after them."""

    def lay_out(self, values: tuple[Any, ...]) -> tuple[bytes, Callable[..., bytes]]:
        """Lay out values; return the new `kept`."""
        raw = self._written(values)
        self.kept, self.values = (raw, self._pack((self._at + len(raw)) & 7)), values
        return self.kept

    def _written(self, values: tuple[Any, ...]) -> bytes:
        begin = len(cdr.HEADER) + self._at
        out, rest = bytearray(begin), iter(values)
        for item in self._words:
            if isinstance(item, Open):
                field, value = item.field, next(rest)
                if field.count is None:
                    cdr.write_strings(out, (value,))
                else:
                    cdr.values_writer(field)(out, value)
            else:
                value = item.value if isinstance(item, Constant) else next(rest)
                out += bytes(-(len(out) - len(cdr.HEADER)) % struct.calcsize(f"<{item.code}"))
                out += struct.pack(f"<{item.code}", value)
        return bytes(out[begin:])

    def _pack(self, phase: int) -> Callable[..., bytes]:
        """Return the function that packs a rest which begins at offset `phase` modulo 8."""
        if phase not in self._packs:
            block = Block(_closed(self._rest), phase)
            pack = block.struct(last=True).pack
            taken, arguments = [], []
            for place, argument in enumerate(block.arguments):
                constant = argument.startswith("CONSTANT_")
                arguments.append(argument if constant else f"a{place}")
                taken += [] if constant else [f"a{place}"]
            known = {f"CONSTANT_{place}": raw for place, raw in enumerate(block.constants)}
            text = f"lambda {', '.join(taken)}: pack({', '.join(arguments)})"
            self._packs[phase] = eval(text, {"pack": pack, **known})
        return self._packs[phase]
