# SPDX-License-Identifier: Apache-2.0
"""Messages as JSON, in the form that rosbridge and Foxglove know. NaN and infinity become null."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from typing import Any

try:
    import msgspec
except ImportError:  # the standard library does the same, slower
    msgspec = None  # type: ignore[assignment]


def plain(value: Any) -> Any:
    """Return a message as dictionaries, lists and numbers that JSON has."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if dataclasses.is_dataclass(value):
        return {key.name: plain(getattr(value, key.name)) for key in dataclasses.fields(value)}
    return value


def encode_slowly(message: Any) -> bytes:
    """Encode as `encode` does, by the standard library alone."""
    try:
        return _ENCODER.encode(message).encode()
    except ValueError:  # a number that JSON does not have
        return _ENCODER.encode(plain(message)).encode()


def _fields(record: Any) -> dict[str, Any]:
    """Return one level of a message; the encoder requests the next."""
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


_ENCODER = json.JSONEncoder(allow_nan=False, separators=(",", ":"), default=_fields)
encode: Callable[[Any], bytes] = encode_slowly if msgspec is None else msgspec.json.Encoder().encode
"""Function that returns a message, or a value that JSON has, as JSON without a line end."""


_TEXTS = json.JSONEncoder(ensure_ascii=False)


def decode(raw: str | bytes) -> Any:
    """Decode JSON. Raises ValueError, also for JSON that is nested too deeply or has a text that is
    not valid: half a surrogate pair (RFC 8259, section 8.2) could not be answered or logged."""
    try:
        value = json.loads(raw)
        _TEXTS.encode(value).encode()
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return value
