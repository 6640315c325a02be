# SPDX-License-Identifier: Apache-2.0
"""Quality of service."""

from dataclasses import dataclass
from enum import IntEnum


class HistoryPolicy(IntEnum):
    KEEP_LAST = 1


class ReliabilityPolicy(IntEnum):
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy(IntEnum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2


@dataclass(kw_only=True)
class QoSProfile:
    depth: int
    history: HistoryPolicy = HistoryPolicy.KEEP_LAST
    reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE


def profile(given):
    """Return a QoS profile; a number is the depth of one with default values."""
    return QoSProfile(depth=given) if isinstance(given, int) else given


def compatible(offered, requested):
    """Return whether a writer's QoS offers at least what the reader's QoS requests."""
    return (
        offered.reliability <= requested.reliability and offered.durability <= requested.durability
    )
