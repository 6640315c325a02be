# SPDX-License-Identifier: Apache-2.0
"""Prints docs/messages.md: python -m motord.bus.messages > docs/messages.md."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from motord.bus.messages.description import DESCRIPTIONS, Description
from motord.bus.messages.table import TYPES

HEAD = """\
# Messages: every field, where it comes from, and its unit

Each topic of [the tree](buses.md#topics) with the fields that motord fills. Fields of the type that
are not named here are zero or empty. NaN (in JSON: null) is what was not measured.

`now` is the newest [state page](state-page.md); `view` also has the daemon's last answer to
`status`; `joint` stands for each joint, in the order of the robot file. This page is made from
`daemon/motord/bus/messages/tree.py`: edit that one, then run
`python -m motord.bus.messages > docs/messages.md`.
"""


def _type_of(described: Description, path: str) -> str:
    kind, count = described.type_name, ""
    for name in path.replace("[0]", "").split("."):
        (field,) = [field for field in TYPES[kind] if field.name == name]
        kind = field.kind
        count = "" if field.count is None else f"[{field.count or ''}]"
    return f"{kind.replace('/msg/', '/')}{count}"


def _section(described: Description) -> Iterator[str]:
    yield f"\n## {described.topic}: {described.type_name.replace('/msg/', '/')}\n"
    for needed in (text for word, text in described.steps if word == "needs"):
        yield f"Sent where `{needed}`.\n"
    yield "| field | type | from | unit, meaning |"
    yield "|---|---|---|---|"
    for row in described.rows:
        if row.source:
            kind = _type_of(described, row.path)
            yield f"| `{row.path}` | {kind} | {_source(row.source)} | {row.note} |"


def _source(source: str) -> str:
    """Return the text of an expression; of a matrix only its different elements."""
    if not source.startswith("["):
        return f"`{source}`"
    cells = ast.parse(source, mode="eval").body
    assert isinstance(cells, ast.List)
    different = dict.fromkeys(ast.unparse(cell) for cell in cells.elts)
    return ", ".join(f"`{cell}`" for cell in different if cell != "0.0") + ", zeros"


def page() -> str:
    """Return the whole page."""
    lines = [line for described in DESCRIPTIONS.values() for line in _section(described)]
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
