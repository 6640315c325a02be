# SPDX-License-Identifier: Apache-2.0
"""Parameters of the local socket's methods: a dataclass for each method, whose fields check their
values. Python's own types and a few ranges suffice: a library for this takes 6 MB of the daemon's
memory."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from typing import Any, TypeGuard

Check = Callable[[Any], Any]
"""Function from a JSON value to the parameter's value. Raises ValueError with the reason, in a few
words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Params:
    """Parameters by name; this class takes none."""


def _is_text(value: Any) -> TypeGuard[str]:
    """Return whether it is a text that can be logged and sent on: half a surrogate pair (RFC 8259,
    section 8.2) cannot."""
    try:
        return isinstance(value, str) and value.encode() is not None
    except UnicodeEncodeError:
        return False


def _taking(check: Check, default: Any) -> Any:
    return dataclasses.field(default=default, metadata={"check": check})


def number(
    low: float = -math.inf, high: float = math.inf, *, whole: bool = False, default: Any = MISSING
) -> Any:
    """Declare a finite number within low..high. A default of None allows null, too."""
    span = f" of {low:g} to {high:g}" if math.isfinite(low) and math.isfinite(high) else ""

    def check(value: Any) -> float | None:
        if value is None and default is None:
            return None
        good = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
        if not good or not math.isfinite(value) or not low <= value <= high:
            raise ValueError(f"must be a {'whole ' if whole else ''}number{span}")
        return value if whole else float(value)

    return _taking(check, default)


def text(chars_max: int, pattern: str = "", *, default: Any = MISSING) -> Any:
    """Declare a string of at most so many characters, which matches the pattern as a whole."""
    # the length is no part of the pattern: 64 times all letters of Unicode take 1.6 MB
    matches = re.compile(pattern or "(?s:.*)").fullmatch

    def check(value: Any) -> str:
        if not _is_text(value) or len(value) > chars_max:
            raise ValueError(f"must be a string of at most {chars_max} characters")
        if not matches(value):
            raise ValueError(f"must match {pattern}")
        return value

    return _taking(check, default)


def flag() -> Any:
    """Declare true or false; false by default."""

    def check(value: Any) -> bool:
        if not isinstance(value, bool):
            raise ValueError("must be true or false")
        return value

    return _taking(check, default=False)


def names() -> Any:
    """Declare a list of strings; empty by default."""

    def check(value: Any) -> tuple[str, ...]:
        if not isinstance(value, list) or not all(map(_is_text, value)):
            raise ValueError("must be a list of strings")
        return tuple(value)

    return _taking(check, ())


def values() -> Any:
    """Declare finite numbers by name; None by default."""
    one = number().metadata["check"]

    def check(value: Any) -> dict[str, float]:
        if not isinstance(value, dict):
            raise ValueError("must be an object of numbers")
        return {name: one(item) for name, item in value.items()}

    return _taking(check, None)


def checked(kind: type[Params], raw: Mapping[str, Any]) -> Params:
    """Return the parameters, checked. Raises ValueError with all that is wrong, in one line."""
    fields = {field.name: field for field in dataclasses.fields(kind)}
    problems = [f"{name}: there is no such parameter" for name in raw if name not in fields]
    values = {}
    for name, field in fields.items():
        if name in raw:
            try:
                values[name] = field.metadata["check"](raw[name])
            except (ValueError, OverflowError) as error:
                problems.append(f"{name}: {error}")
        elif field.default is MISSING:
            problems.append(f"{name}: is missing")
    if problems:
        raise ValueError("; ".join(problems))
    return kind(**values)
