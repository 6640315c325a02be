# SPDX-License-Identifier: Apache-2.0
"""The datagram by which every command enters: docs/commands.md, csrc/api_command.h."""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence
from dataclasses import dataclass

MAGIC = 0x434D544D
VERSION = 2
TOKEN_BYTES = 16
TWIST = 1
RELEASE = 2
JOINTS = 3
JOINTS_MAX = 8
_LAYOUT = struct.Struct("<IHH16sQqIIddd")
_JOINTS_LAYOUT = struct.Struct(f"<IHH16sQqII{JOINTS_MAX}d")


class Refusal(enum.IntEnum):
    """Why a datagram was not obeyed: places in `CommandReport.refused`."""

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
    """Commands that come more often are refused, but for zero; 0: as often as they like."""
    barred_until_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseState:
    """What the loop knows of a lease. The speeds as asked for."""

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

    def fresh(self, now_ns: int) -> bool:
        """A command of it is alive."""
        return self.sequence != 0 and now_ns < self.expires_ns

    @property
    def wants_motion(self) -> bool:
        return any((self.linear_m_s, self.angular_rad_s, self.lateral_m_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReport:
    """The arbiter's word after its newest look at what came."""

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
