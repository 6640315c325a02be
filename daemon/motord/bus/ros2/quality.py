# SPDX-License-Identifier: Apache-2.0
"""Quality of service, as ROS 2 names it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Distribution = Literal["humble", "jazzy"]
"""Of ROS 2; Iron and later are as Jazzy."""


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
