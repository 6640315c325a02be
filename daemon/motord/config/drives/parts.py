# SPDX-License-Identifier: Apache-2.0
"""Types that the tables of a drive profile share: names, units, raw values, scales."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, StringConstraints
from pydantic_core import PydanticKnownError

from motord.config.sections.section import Section, number

PART_NAME, CHANNEL = r"^[a-z][a-z0-9_]*$", r"^[1-8]$"
PartName = Annotated[str, StringConstraints(pattern=PART_NAME)]
Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
Unit = Literal[
    "", "count", "rpm", "rad/s", "turn", "turn/s", "percent", "n_m", "a", "v", "c", "s", "ms"
]
"""The units of profile.SI_UNITS."""
Access = Literal["r", "w", "rw"]
RAW_MIN, RAW_MAX = -(1 << 31), (1 << 32) - 1
BOUND = 1e12
"""Bound of scales and limits: beyond those of any drive."""


def _whole(value: Any) -> Any:
    """Refuse true for 1, and 1.0, in a choice of numbers."""
    if type(value) is not int:
        raise PydanticKnownError("int_type")
    return value


WHOLE = BeforeValidator(_whole)


def Mask(default: Any = ...) -> Any:  # noqa: N802  beside Field
    """Declare a mask for a register of up to 32 bits."""
    return number("bits that count", 1, 0xFFFFFFFF, "1", default)


class Scaled(Section):
    """A raw value and what it means: raw × scale in its unit."""

    scale: float = number("`unit` for each 1 of the raw value", -BOUND, BOUND, "1", 1.0)
    minimum: float | None = number("smallest value, in `unit`", -BOUND, BOUND, "1", None)
    maximum: float | None = number("largest value, in `unit`", -BOUND, BOUND, "1", None)
    default: int = number(
        "raw value at power-up: the simulator starts with it", RAW_MIN, RAW_MAX, "1", 0
    )
