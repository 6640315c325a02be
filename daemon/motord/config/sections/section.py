# SPDX-License-Identifier: Apache-2.0
"""Base of every table of the robot file, and its numbers with a unit and a range.

One process reads the file and checks it by pydantic. Processes that live long only hold the result,
as plain values of the same classes: `validation.py` knows which kind this process is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from motord.base import validation

if TYPE_CHECKING or validation.HERE:
    from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, StringConstraints
else:
    from motord.config.plain import BaseModel, ConfigDict, Field, PrivateAttr, StringConstraints

__all__ = ["Field", "Name", "Number", "PrivateAttr", "Section", "number", "numbers_of"]

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]


@dataclass(frozen=True, slots=True)
class Number:
    """Range and unit of a number of the robot file. `high` None: no upper end, infinity allowed."""

    description: str
    low: float
    high: float | None
    unit: str

    def takes(self, value: Any) -> bool:
        """Return whether the value is a number within the range."""
        if not isinstance(value, int | float) or isinstance(value, bool):
            return False
        return self.low <= value <= (math.inf if self.high is None else self.high)

    @property
    def span(self) -> str:
        """The range, in words."""
        if self.high is None:
            return f"at least {self.low:g} {self.unit}"
        return f"{self.low:g} to {self.high:g} {self.unit}"


def number(
    description: str,
    low: float,
    high: float | None,
    unit: str,
    default: Any = ...,
) -> Any:
    """Declare a number within low..high (None: no upper end, infinity allowed) with its unit. A
    callable default makes the value from those above it."""
    start = {"default_factory" if callable(default) else "default": default}
    return Field(
        **start,
        description=description,
        ge=low,
        le=high,
        json_schema_extra={"unit": unit},
        allow_inf_nan=high is None,
    )


class Section(BaseModel):
    """A table of the robot file: no unknown key, no text for a number, no change afterwards."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        defer_build=True,  # most tables need no validator of their own in a process
        allow_inf_nan=False,
        field_title_generator=lambda name, _: name,
    )


def numbers_of(section: type[Section]) -> dict[str, Number]:
    """Return the numbers of a section by name, with the arguments of `number` for each."""
    found = {}
    for name, field in section.model_fields.items():
        extra, low, high = field.json_schema_extra, -math.inf, None
        for rule in field.metadata:
            low, high = getattr(rule, "ge", low), getattr(rule, "le", high)
        if isinstance(extra, dict) and "unit" in extra:
            found[name] = Number(field.description or "", low, high, str(extra["unit"]))
    return found
