# SPDX-License-Identifier: Apache-2.0
"""Problems of a robot file, and where they are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from motord_hal.base.nearest import nearest


@dataclass(frozen=True, slots=True)
class Problem:
    """A problem, printed as `file:line: key: problem`. Line 0: no line (an option, a missing
    file)."""

    file: str
    line: int
    key: str
    text: str

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}" if self.line else self.file
        row = f"{where}: {self.key}: {self.text}" if self.key else f"{where}: {self.text}"
        return " ".join(row.splitlines())  # one problem, one line, whatever a key holds

    def as_warning(self) -> Problem:
        """Return the same problem, marked as a warning."""
        return replace(self, text=f"warning: {self.text}")


class ConfigError(ValueError):
    """Error for a robot file that cannot be used; `problems` are all of its problems."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(map(str, self.problems)))


def candidates(word: str, known: Iterable[str]) -> list[str]:
    """Return the known words that may be meant: those that begin with it, or else the nearest
    one."""
    words = list(known)
    begun = [other for other in words if len(word) > 2 and other.startswith(word)]
    near = nearest(word, words)
    return begun or ([near] if near else [])


def dotted(path: Iterable[str | int]) -> str:
    """Return a path as TOML writes a key, with [i] for array elements."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text
