# SPDX-License-Identifier: Apache-2.0
"""Messages as JSON has them: the shape that rosbridge and Foxglove know. NaN and infinity:
null."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any


def plain(value: Any) -> Any:
    """A message as dictionaries, lists and numbers that JSON has."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    if dataclasses.is_dataclass(value):
        return {key.name: plain(getattr(value, key.name)) for key in dataclasses.fields(value)}
    return value


def encode(message: Any) -> bytes:
    """One JSON object, without a line end."""
    return json.dumps(plain(message), allow_nan=False, separators=(",", ":")).encode()
