# SPDX-License-Identifier: Apache-2.0
"""The datagram of a command, the only form in which commands enter: docs/commands.md,
csrc/api/api_command.h."""

from __future__ import annotations

import enum
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

MAGIC = 0x434D544D
VERSION = 2
POSITIONS_VERSION = 3
"""Version of the layout that has positions."""
TOKEN_BYTES = 16
TWIST = 1
RELEASE = 2
JOINTS = 3
JOINTS_MAX = 8
_PLACES = range(JOINTS_MAX)
_LAYOUT = struct.Struct("<IHH16sQqIIddd")
_JOINTS_LAYOUT = struct.Struct(f"<IHH16sQqII{JOINTS_MAX}d")
_POSITIONS_LAYOUT = struct.Struct(f"<IHH16sQqII{2 * JOINTS_MAX}dII")


class Refusal(enum.IntEnum):
    """Reasons for which a datagram is refused; `CommandReport.refused` counts by them."""

    FORM = 0
    TOKEN = 1
    SEQUENCE = 2
    AGE = 3
    LIFETIME = 4
    NOT_FINITE = 5
    JOINTS = 6
    RATE = 7
    OUT_OF_RANGE = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseGrant:
    """Rights of a source. Any program that has the token may command under it."""

    number: int
    """Grows with each lease, from 1."""
    token: bytes
    priority: int
    lifetime_ns: int
    interval_least_ns: int = 0
    """Commands that come more often than this are refused, except zero commands; 0: no limit."""
    barred_until_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseState:
    """State of a lease in the loop. The speeds are those that were requested."""

    number: int
    held: bool
    sequence: int
    """Sequence number of the last command; 0: no command has come."""
    stamp_ns: int
    expires_ns: int
    since: int
    """Position in the order in which the leases became alive."""
    priority: int
    interval_ns: int
    """Interval between two commands, smoothed; 0: fewer than two have come."""
    linear_m_s: float
    angular_rad_s: float
    lateral_m_s: float = 0.0
    wants_motion: bool = False
    """Whether a value other than zero was requested."""
    joint_values_u: Mapping[int, float] = field(default_factory=dict)
    """Requested value of each joint of a robot without a base, by joint index: rad for a joint that
    takes positions, otherwise rad/s."""

    def fresh(self, now_ns: int) -> bool:
        """Return whether the last command of the lease has not expired."""
        return self.sequence != 0 and now_ns < self.expires_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReport:
    """The arbiter's report after its last look at the received datagrams."""

    commander: int
    """Number of the lease in command; 0: no lease."""
    accepted: int
    refused: dict[Refusal, int]
    leases: dict[int, LeaseState]
    """State of each lease, by its number."""
    sideways: int = 0
    """Accepted commands whose lateral part counts as zero: this base cannot move sideways."""
    on_spot: int = 0
    """Accepted commands whose turn on the spot counts as zero: this base cannot do it."""


def datagram(
    token: bytes,
    sequence: int,
    stamp_ns: int,
    linear_m_s: float,
    angular_rad_s: float,
    *,
    lateral_m_s: float = 0.0,
    lifetime_ms: int = 0,
    kind: int = TWIST,
) -> bytes:
    """Return a command of a twist. `stamp_ns` is CLOCK_MONOTONIC; lifetime 0: that of the lease."""
    head = (MAGIC, VERSION, kind, token, sequence, stamp_ns, lifetime_ms, 0)
    return _LAYOUT.pack(*head, linear_m_s, angular_rad_s, lateral_m_s)


def joint_datagram(
    token: bytes,
    sequence: int,
    stamp_ns: int,
    velocity_rad_s: Sequence[float],
    *,
    lifetime_ms: int = 0,
) -> bytes:
    """Return a command of all wheels, in the order of the robot file, at most JOINTS_MAX."""
    padded = (*velocity_rad_s, *([0.0] * (JOINTS_MAX - len(velocity_rad_s))))
    head = (MAGIC, VERSION, JOINTS, token, sequence, stamp_ns, lifetime_ms, len(velocity_rad_s))
    return _JOINTS_LAYOUT.pack(*head, *padded)


def position_datagram(
    token: bytes,
    sequence: int,
    stamp_ns: int,
    joint_count: int,
    velocity_rad_s: Mapping[int, float],
    position_rad: Mapping[int, float],
    *,
    lifetime_ms: int = 0,
) -> bytes:
    """Return a command of joints without a base, by their index in the robot file. A joint that is
    left out comes to rest or, if it takes positions, goes on to its last position from this
    lease."""
    head = (MAGIC, POSITIONS_VERSION, JOINTS, token, sequence, stamp_ns, lifetime_ms, joint_count)
    values = [kind.get(j, 0.0) for kind in (velocity_rad_s, position_rad) for j in _PLACES]
    masks = (sum(1 << j for j in kind) for kind in (velocity_rad_s, position_rad))
    return _POSITIONS_LAYOUT.pack(*head, *values, *masks)
