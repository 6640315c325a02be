# SPDX-License-Identifier: Apache-2.0
"""A node's parameter."""

from dataclasses import dataclass
from typing import Any


@dataclass
class Parameter:
    name: str
    value: Any = None
