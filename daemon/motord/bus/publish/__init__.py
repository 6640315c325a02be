# SPDX-License-Identifier: Apache-2.0
"""From a publisher's kind to the class that does it."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Protocol, cast

from motord.bus.publish.samples import Samples
from motord.config import Publish

# A table of strings: a robot loads only the buses that it has.
KINDS = MappingProxyType(
    {
        "stdout": "motord.bus.publish.stdout:StdoutPublisher",
        "udp": "motord.bus.publish.udp:UdpPublisher",
    }
)
ENTRY_POINTS = "motord.publishers"
"""Group in which another package may offer kinds of its own."""


class Publisher(Protocol):
    """Passes samples on. It may be as slow as it likes: what it does not take in time is lost."""

    async def run(self, samples: Samples) -> None:
        """Until cancelled; the world's faults are logged once and survived."""
        ...


def open_publisher(name: str, kind: str, section: Publish) -> Publisher:
    """The publisher for [publish.NAME]. Raises LookupError for a kind that nobody offers."""
    if kind in KINDS:
        module, _, attribute = KINDS[kind].partition(":")
        made = getattr(import_module(module), attribute)
    else:
        offered = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
        if kind not in offered:
            known = ", ".join([*KINDS, *offered])
            raise LookupError(f'publish.{name}: nobody offers kind "{kind}"; there are: {known}')
        made = offered[kind].load()
    return cast("Publisher", made(name, section))
