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
SENDER_SHIFT = 8
SENDERS_NAMED = range(1, 31)
"""Numbers of senders that share a lease; the sender of a lease that is not shared is 0."""
SENDER_UNNAMED = 31
"""Number of all senders of a lease that its program cannot distinguish."""
JOINTS_MAX = 8
POSITIONS_CLAMP = 1 << 30
BEYOND_RAD = 0.02
"""How far a position may be beyond its range, as in csrc/loop/command/arbiter.c."""
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
    barred_ns: int = 0
    """When another lease of the owner was held that has ended; 0: never."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseState:
    """State of a lease in the loop. The speeds are those that were requested."""

    number: int
    held: bool
    """Whether its command counts as zero; only a zero, or a person, ends that."""
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
    open: bool = False
    """Whether motion was requested, and neither zero nor an end since, however long ago."""
    lapses: int = 0
    """Commands in a row that came after the one before had expired."""
    held_ns: int = 0
    """When the first of its senders that are held was held, CLOCK_MONOTONIC."""
    senders_held: int = 0
    """Number of its senders that are held, also those that are silent now."""
    taken_ns: int = 0
    """When the newest command came, CLOCK_MONOTONIC."""
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
    sender: int = 0,
) -> bytes:
    """Return a command of a twist. `stamp_ns` is CLOCK_MONOTONIC; lifetime 0: that of the lease.
    `sender`: 0, one of SENDERS_NAMED, or SENDER_UNNAMED."""
    head = (
        MAGIC,
        VERSION,
        kind | sender << SENDER_SHIFT,
        token,
        sequence,
        stamp_ns,
        lifetime_ms,
        0,
    )
    return _LAYOUT.pack(*head, linear_m_s, angular_rad_s, lateral_m_s)


def joint_datagram(
    token: bytes,
    sequence: int,
    stamp_ns: int,
    velocity_rad_s: Sequence[float],
    *,
    lifetime_ms: int = 0,
    sender: int = 0,
) -> bytes:
    """Return a command of all wheels, in the order of the robot file, at most JOINTS_MAX. `sender`:
    as for `datagram`."""
    padded = (*velocity_rad_s, *([0.0] * (JOINTS_MAX - len(velocity_rad_s))))
    kind, joint_count = JOINTS | sender << SENDER_SHIFT, len(velocity_rad_s)
    head = (MAGIC, VERSION, kind, token, sequence, stamp_ns, lifetime_ms, joint_count)
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
    clamp: bool = False,
    sender: int = 0,
) -> bytes:
    """Return a command of joints without a base, by their index in the robot file. A joint that is
    left out comes to rest or, if it takes positions, goes on to its last position from this
    lease. `clamp`: a position beyond its joint's range means the end of the range; otherwise the
    command is refused. `sender`: as for `datagram`."""
    kind_of = JOINTS | sender << SENDER_SHIFT
    head = (MAGIC, POSITIONS_VERSION, kind_of, token, sequence, stamp_ns, lifetime_ms, joint_count)
    values = [kind.get(j, 0.0) for kind in (velocity_rad_s, position_rad) for j in _PLACES]
    velocities, positions = (sum(1 << j for j in kind) for kind in (velocity_rad_s, position_rad))
    positions |= POSITIONS_CLAMP if clamp else 0
    return _POSITIONS_LAYOUT.pack(*head, *values, velocities, positions)


MARGINS = {"rad": BEYOND_RAD, "m/s": 0.001, "rad/s": 0.001}
"""How far a value may be beyond its range, by its unit, for rounding: it means the end then."""


def out_of_range(name: str, value: float, low: float, high: float, unit: str) -> str:
    """Return that a value is beyond its range, with the range and the unit; empty: it is not. For
    every command whose value has a range of its own. A twist has none: a joystick and Nav2 request
    more than the limits as a matter of course, and the core scales it (docs/commands.md)."""
    if low - MARGINS[unit] <= value <= high + MARGINS[unit]:
        return ""
    return f"{name} = {value:g} is beyond its range, {low:g} to {high:g} {unit}"


def beyond(ranges_rad: Mapping[str, tuple[float, float]], position_rad: Mapping[str, float]) -> str:
    """Return which positions are beyond the ranges of their joints, in words; empty: none is. The
    loop refuses these by the same rule (csrc/loop/command/arbiter.c), and gives no names."""
    found = (
        out_of_range(name, value_rad, *ranges_rad[name], "rad")
        for name, value_rad in position_rad.items()
    )
    return "; ".join(filter(None, found))
