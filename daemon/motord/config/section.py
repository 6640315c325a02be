# SPDX-License-Identifier: Apache-2.0
"""What every table of the robot file is made of: numbers with a unit and a range."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]


def number(
    description: str,
    low: float,
    high: float | None,
    unit: str,
    default: Any = ...,
) -> Any:
    """A number within low..high (None: no upper end, infinity allowed) and its unit. A callable
    default makes the value from those above it."""
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
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        field_title_generator=lambda name, _: name,
    )
