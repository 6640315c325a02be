# SPDX-License-Identifier: Apache-2.0
"""Finds the class for the kind of a publisher that runs in the daemon itself."""

from __future__ import annotations

from types import MappingProxyType
from typing import Protocol, cast

from motord.bus.adapters import PUBLISHER_POINTS, find
from motord.bus.publish.snapshot_feed import SnapshotFeed
from motord.config import Publish

KINDS = MappingProxyType(
    {
        "stdout": "motord.bus.publish.stdout:StdoutPublisher",
        "udp": "motord.bus.publish.udp:UdpPublisher",
    }
)


class Publisher(Protocol):
    """Passes snapshots on. It may be slow: what it does not take in time is lost."""

    async def run(self, feed: SnapshotFeed) -> None:
        """Run until cancelled. Log a failure outside motord once, and go on."""
        ...


def open_publisher(name: str, kind: str, section: Publish) -> Publisher:
    """Create the publisher for [publish.NAME]. Raises LookupError for a kind that no package
    offers."""
    made = find(f"publish.{name}", kind, KINDS, PUBLISHER_POINTS)
    return cast("Publisher", made(name, section))
