# SPDX-License-Identifier: Apache-2.0
"""The datagram by which every command enters: docs/commands.md, csrc/api/api_command.h."""

from __future__ import annotations

import enum
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

MAGIC = 0x434D544D
VERSION = 2
POSITIONS_VERSION = 3
"""Of the layout that has positions."""
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
    """Why a datagram was refused: indices of `CommandReport.refused`."""

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
    """What a source may do: the token is enough to command under it."""

    number: int
    """Grows with each lease, from 1."""
    token: bytes
    priority: int
    lifetime_ns: int
    interval_least_ns: int = 0
    """Commands that come more often are refused, but for zero; 0: no limit."""
    barred_until_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseState:
    """What the loop knows of a lease. The speeds are those that were requested."""

    number: int
    held: bool
    sequence: int
    """0: no command has come."""
    stamp_ns: int
    expires_ns: int
    since: int
    """Order in which the leases came alive."""
    priority: int
    interval_ns: int
    """From one command to the next, smoothed; 0: fewer than two have come."""
    linear_m_s: float
    angular_rad_s: float
    lateral_m_s: float = 0.0
    wants_motion: bool = False
    """A value other than zero was requested."""
    joint_values_u: Mapping[int, float] = field(default_factory=dict)
    """Of a robot without a base, by place: rad of a joint that takes positions, rad/s of another
    one."""

    def fresh(self, now_ns: int) -> bool:
        """A command of it is alive."""
        return self.sequence != 0 and now_ns < self.expires_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReport:
    """The arbiter's report after it last looked at what came."""

    commander: int
    """Number of the lease in command; 0: none."""
    accepted: int
    refused: dict[Refusal, int]
    leases: dict[int, LeaseState]
    """By number."""
    sideways: int = 0
    """Accepted, but for a lateral part that this base cannot do and that counts as zero."""
    on_spot: int = 0
    """The same of a turn on the spot."""


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
    """One command; `stamp_ns` is CLOCK_MONOTONIC, lifetime 0 is the lease's own."""
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
    """One command of all wheels, in the order of the robot file: at most JOINTS_MAX."""
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
    """One command of joints without a base, by their place in the robot file. A joint that is left
    out comes to rest or, where it takes positions, goes on to the one that this lease gave it."""
    head = (MAGIC, POSITIONS_VERSION, JOINTS, token, sequence, stamp_ns, lifetime_ms, joint_count)
    values = [kind.get(j, 0.0) for kind in (velocity_rad_s, position_rad) for j in _PLACES]
    masks = (sum(1 << j for j in kind) for kind in (velocity_rad_s, position_rad))
    return _POSITIONS_LAYOUT.pack(*head, *values, *masks)
