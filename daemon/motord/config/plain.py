# SPDX-License-Identifier: Apache-2.0
"""Replacements for what the tables of the robot file use of pydantic, for a process that only holds
values which another one has checked: pydantic and its validators take 14 MB of memory."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, ClassVar, Self

ConfigDict = dict


class Field:
    """A field as its class declares it. On an object, it is the default of a field without a
    value."""

    def __init__(
        self,
        default: Any = ...,
        *,
        description: str | None = None,
        json_schema_extra: Any = None,
        ge: float | None = None,
        le: float | None = None,
        **_more: Any,
    ) -> None:
        self.default = default
        self.description = description
        self.json_schema_extra = json_schema_extra
        ends = {"ge": ge, "le": le}
        self.metadata = [SimpleNamespace(**{k: v}) for k, v in ends.items() if v is not None]

    def __get__(self, found: Any, kind: type) -> Any:
        """Return the field for a class, its default for an object that has no value of its own."""
        return self if found is None else self.default


def PrivateAttr(default: Any) -> Any:  # noqa: N802  pydantic's name
    """Declare a value that is no key of the file."""
    return default


def StringConstraints(**rules: Any) -> dict[str, Any]:  # noqa: N802  pydantic's name
    """Declare what a string may be; this has been checked already."""
    return rules


class BaseModel:
    """An object whose values are attributes that do not change."""

    __slots__ = ("__dict__", "model_fields_set")
    model_fields: ClassVar[dict[str, Field]] = {}
    model_fields_set: set[str]

    def __init_subclass__(cls) -> None:
        own = {name: field for name, field in vars(cls).items() if isinstance(field, Field)}
        cls.model_fields = cls.model_fields | own

    def __init__(self, **values: Any) -> None:
        self._set(values, set(values))

    def _set(self, values: dict[str, Any], given: set[str]) -> None:
        vars(self).update(values)
        object.__setattr__(self, "model_fields_set", given)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state in the form in which pydantic pickles objects."""
        return {
            "__dict__": vars(self),
            "__pydantic_private__": None,
            "__pydantic_fields_set__": self.model_fields_set,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take a state in the form in which pydantic pickles objects."""
        private = state["__pydantic_private__"] or {}
        self._set(state["__dict__"] | private, state["__pydantic_fields_set__"])

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__}.{name} does not change")

    def model_copy(self, *, update: dict[str, Any]) -> Self:
        """Return a copy with other values."""
        copy = object.__new__(type(self))
        copy._set(vars(self) | update, self.model_fields_set | set(update))
        return copy
