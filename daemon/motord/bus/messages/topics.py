# SPDX-License-Identifier: Apache-2.0
"""The tree of topics that every bus carries: docs/buses.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from motord.api.snapshot import Snapshot
from motord.bus.messages.description import DESCRIPTIONS
from motord.bus.messages.sources import Commander


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """What is known at one moment: the newest snapshot, and the newest report of the daemon."""

    snapshot: Snapshot
    status: Mapping[str, Any] | None = None
    """The daemon's answer to `status` on the local socket; None: not requested yet, or no
    answer."""
    status_ns: int = 0
    """When the status was requested, CLOCK_MONOTONIC."""

    def battery(self) -> Mapping[str, Any] | None:
        """Return the battery of the daemon's status; None: no [battery], or the daemon has not
        reported it yet."""
        return (self.status or {}).get("battery")

    def why(self) -> tuple[str, ...]:
        """Return what led to the latched faults; empty: no fault is latched, or the daemon has not
        reported the reason."""
        return tuple((self.status or {}).get("why", ())) if self.snapshot.faults else ()

    def loop(self) -> Mapping[str, Any] | None:
        """Return statistics of the real-time loop; None: no answer of the daemon yet."""
        return None if self.status is None else self.status["loop"]

    def commander(self) -> Commander | None:
        """Return the source whose lease is in command; None: no source commands, or the daemon has
        not reported it yet."""
        for lease in (self.status or {}).get("leases", ()):
            if lease["number"] == self.snapshot.owner:
                return Commander(owner=lease["owner"], priority=lease["priority"], why=lease["why"])
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the tree; `motord.bus.messages.forms` makes its messages."""

    name: str
    type_name: str
    """Type of the messages in ROS 2; our own types are of the package motord_msgs."""


TOPICS = MappingProxyType(
    {name: Topic(name=name, type_name=one.type_name) for name, one in DESCRIPTIONS.items()}
)
"""Topics by name."""
