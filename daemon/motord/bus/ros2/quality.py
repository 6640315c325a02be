# SPDX-License-Identifier: Apache-2.0
"""Settings of an endpoint: its quality of service in the terms of ROS 2, and the functions it
calls."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Literal

from motord.bus.commands.senders import Sender

Distribution = Literal["humble", "jazzy"]
"""Distribution of ROS 2; "jazzy" also stands for Iron and all later ones."""
Take = Callable[[SimpleNamespace, float, Sender], None]
"""Function that takes each message of a topic, its time in transit in s, and its sender."""
Answer = Callable[[SimpleNamespace], Awaitable[SimpleNamespace]]
"""Function that answers a request of a service. It does not raise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """Quality of service of an endpoint. Its history is always KEEP_LAST: new samples replace old
    ones."""

    depth: int = 10
    reliable: bool = True
    latched: bool = False
    """TRANSIENT_LOCAL: a reader that joins later also gets the newest messages."""
    alone: bool = True
    """False: another endpoint of the node serves the peers that this one does not match."""


_LATCHED = Quality(depth=1, latched=True)
_OFFERED = {
    "tf": Quality(depth=100),  # as tf2_ros has it
    "tf_static": _LATCHED,
    "robot_description": _LATCHED,
    "/rosout": Quality(depth=1000, latched=True),  # as rcl has it
}


def offered(topic: str) -> Quality:
    """Return the quality of service that motord's publisher of a topic offers."""
    return _OFFERED.get(topic, Quality())
