# SPDX-License-Identifier: Apache-2.0
"""Reads the descriptions of `motord.bus.messages.tree`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from types import MappingProxyType

from motord.bus.messages.tree import TREE

_ROW = re.compile(
    r"(?:(?P<type>[\w/]+(?:\[\])?) )?(?P<path>\w+(?:\[0\])?(?:\.\w+)*)"
    r"(?: = (?P<source>.+?))?(?:  # (?P<note>.*))?"
)
_OPEN, _CLOSE = "[({", "])}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One field of a message."""

    path: str
    """Path from the message's root: `pose.pose.position.x`."""
    type_name: str
    """Type in .msg notation, if this row defines it; empty: ROS 2 defines the type."""
    source: str
    """Python expression of the value; empty: the rows below it fill the field's parts."""
    note: str
    """Unit of the field, and remarks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Description:
    """The description of one topic."""

    topic: str
    type_name: str
    steps: tuple[tuple[str, str], ...]
    """Pairs of `let` or `needs` and its text, in their order."""
    joints: str
    """The expression that chooses the joints; empty: all joints."""
    rows: tuple[Row, ...]

    @property
    def names_joints(self) -> bool:
        """Whether the message is about joints."""
        return bool(self.joints) or any("joint." in row.source for row in self.rows)

    def definition(self) -> str:
        """Return the type in the notation of `motord.bus.messages.definitions`; empty: ROS 2
        defines it."""
        lines = [f"{row.type_name} {row.path}" for row in self.rows if row.type_name]
        return "\n".join([f"=== {self.type_name}", *lines, ""]) if lines else ""


def _lines(block: str) -> Iterator[str]:
    """Yield the lines of a block; a line that opens a bracket goes on until it is closed."""
    whole = ""
    for line in block.splitlines():
        whole = f"{whole} {line.strip()}".strip()
        if sum(map(whole.count, _OPEN)) == sum(map(whole.count, _CLOSE)):
            yield whole
            whole = ""


def descriptions(text: str) -> dict[str, Description]:
    """Return the descriptions by topic. Raises ValueError for a line that is not one of a
    description."""
    found = {}
    for block in text.split("=== ")[1:]:
        head, *lines = filter(None, _lines(block))
        topic, type_name = head.split()
        steps, joints, rows = [], "", []
        for line in lines:
            word, _, rest = line.partition(" ")
            if word in ("let", "needs"):
                steps.append((word, rest))
            elif word == "joints":
                joints = rest
            elif match := _ROW.fullmatch(line):
                kind, path, source, note = (match[key] or "" for key in _ROW.groupindex)
                rows.append(Row(path=path, type_name=kind, source=source, note=note))
            else:
                raise ValueError(f"{topic}: {line!r} is no line of a description")
        found[topic] = Description(
            topic=topic, type_name=type_name, steps=tuple(steps), joints=joints, rows=tuple(rows)
        )
    return found


DESCRIPTIONS = MappingProxyType(descriptions(TREE))
"""Descriptions by topic, in the order of the tree."""
