# SPDX-License-Identifier: Apache-2.0
"""What an endpoint is made with: its quality of service, as ROS 2 names it, and what it calls."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Literal

Distribution = Literal["humble", "jazzy"]
"""Of ROS 2; Iron and later are as Jazzy."""
Take = Callable[[SimpleNamespace, float, str], None]
"""Gets each message of a topic, how long in s it was in transit, and whose it is."""
Answer = Callable[[SimpleNamespace], Awaitable[SimpleNamespace]]
"""Of a service. It does not raise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """Of an endpoint. Its history is always KEEP_LAST: newest wins."""

    depth: int = 10
    reliable: bool = True
    latched: bool = False
    """TRANSIENT_LOCAL: a later reader gets the newest, too."""
    alone: bool = True
    """False: another endpoint beside it serves those that this one does not match."""


_LATCHED = Quality(depth=1, latched=True)
_OFFERED = {
    "tf": Quality(depth=100),  # as tf2_ros has it
    "tf_static": _LATCHED,
    "robot_description": _LATCHED,
    "/rosout": Quality(depth=1000, latched=True),  # as rcl has it
}


def offered(topic: str) -> Quality:
    """By the publisher of that topic of ours."""
    return _OFFERED.get(topic, Quality())
