# SPDX-License-Identifier: Apache-2.0
"""What the doors to the threads of lines in C have in common, whatever the medium.

The meaning of each field is in csrc/api_line.h.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motord_hal.errors import HalError
from motord_hal.rt import Exchange

Plain = Mapping[str, Any]

_PLACE = ("fd", "event_fd", "priority", "cpu_mask")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineLife:
    """What every report begins with."""

    running: bool
    error: int
    policy: int
    scheduler_errno: int
    page_faults: int


def life_of(raw: Any) -> dict[str, Any]:
    """The values of a LineLife."""
    life = raw.life
    return {
        "running": life.running != 0,
        "error": life.error,
        "policy": life.policy,
        "scheduler_errno": life.scheduler_errno,
        "page_faults": life.page_faults,
    }


def config_of(values: Plain, exchange: Exchange) -> dict[str, Any]:
    """For a thread's config struct: `values` named as in line_place and beside it."""
    place = {name: values[name] for name in _PLACE if name in values}
    rest = {name: value for name, value in values.items() if name not in _PLACE}
    return rest | {"at": place | {"exchange": exchange.handle}}


def check_code(code: int, what: str) -> None:
    """Raises HalError for -errno."""
    if code < 0:
        raise HalError(f"{what}: {os.strerror(-code)}")
