# SPDX-License-Identifier: Apache-2.0
"""Leases, the right of sources to command, by connection and owner. Python starts and ends them.
The loop (csrc/loop/command/arbiter.c) decides which of them is in command and which is held, and
reports it.

The fresh lease with the highest priority commands; among equals the first one. A source that
requests motion while nothing may move is held: its lease counts as zero until the source has sent
zero or its command has lapsed, even if it connects anew for each command."""

from __future__ import annotations

import asyncio
import math
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from motord.api.commands import (
    TOKEN_BYTES,
    CommandReport,
    LeaseGrant,
    LeaseState,
    Refusal,
    datagram,
    position_datagram,
)
from motord.realtime.loop import LEASE_NUMBERS, LEASES_MAX, Loop
from motord_hal.base.clock import within
from motord_hal.realtime.exchange import now_ns

LEASE_MIN_S = 0.02
LEASE_MAX_S = 5.0
JUDGED_WITHIN_S = 0.5
LOOK_EVERY_S = 0.0005
_REFUSED = {
    Refusal.AGE: "it took longer than its lifetime to get to the loop",
    Refusal.NOT_FINITE: "it is not finite",
}


class NoLease(Exception):
    """No lease can be given, or the loop takes no command under it. The text gives the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """A source's right to command, and its newest command."""

    number: int
    owner: str
    connection: int
    priority: int
    stamp_ns: int
    """Stamp of the newest command (CLOCK_MONOTONIC)."""
    expires_ns: int
    since: int
    rate_hz: float
    """Commands a second, smoothed. 0: fewer than two have come."""
    linear_m_s: float
    angular_rad_s: float
    lateral_m_s: float
    held: bool
    """Whether the command counts as zero until the source requests zero or the command lapses."""
    wants_motion: bool
    """Whether a value other than zero was requested, held or not."""
    joint_values_u: Mapping[int, float]
    """Requested values by the joint's place in the robot file, in the units of `LeaseState`."""

    @property
    def why_held(self) -> str:
        return (
            f"{self.owner} went on requesting motion while the robot could not move: "
            "send zero once, or nothing for lease_s, then go on"
        )


@dataclass(slots=True)
class _Granted:
    owner: str
    connection: int
    grant: LeaseGrant
    used_ns: int
    kept: bool
    """Whether its token was given to the client: then it ends with its connection, not by
    lapsing."""
    socket_number: int = 0
    """Number of its own command socket (of LEASES_MAX), if its token was given to the client."""
    sequence: int = 0


class Leases:
    """All leases of the daemon."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._granted: dict[tuple[int, str, bool], _Granted] = {}
        """Leases by connection, owner, and whether the token was given to the client."""
        self._gone: dict[str, int] = {}
        """Owners that were held when their connection ended, and until when (ns) they stay held."""
        self._next_socket = 0
        self._judging = asyncio.Lock()

    # ----------------------------------------------------------------------------------- granting
    def grant(
        self,
        connection: int,
        owner: str,
        priority: int,
        lease_s: float,
        *,
        kept: bool = False,
        rate_max_hz: float | None = None,
    ) -> LeaseGrant:
        """Make or renew the owner's lease on this connection. Raises ValueError for a lifetime out
        of bounds, NoLease if there are too many leases."""
        if not LEASE_MIN_S <= lease_s <= LEASE_MAX_S:
            raise ValueError(f"lease_s is {lease_s}: {LEASE_MIN_S} to {LEASE_MAX_S} s")
        now = now_ns()
        lifetime_ns = round(lease_s * 1e9)
        barred_until_ns = self._gone.pop(owner, 0)  # a lease that exists has it already
        before = self._granted.get((connection, owner, kept))
        if before is None:
            self._make_room(now)
            grant = LeaseGrant(
                number=next(LEASE_NUMBERS),
                token=secrets.token_bytes(TOKEN_BYTES),
                priority=priority,
                lifetime_ns=lifetime_ns,
                interval_least_ns=round(1e9 / rate_max_hz) if rate_max_hz else 0,
                barred_until_ns=barred_until_ns,
            )
            before = _Granted(owner, connection, grant, now, kept, self._free_socket())
            self._granted[connection, owner, kept] = before
            self._publish()
        elif (before.grant.priority, before.grant.lifetime_ns) != (priority, lifetime_ns):
            before.grant = replace(before.grant, priority=priority, lifetime_ns=lifetime_ns)
            self._publish()
        before.used_ns = now
        return before.grant

    def socket_number(self, connection: int, owner: str) -> int:
        """Return the number of the command socket of a lease whose token was given to the
        client."""
        return self._granted[connection, owner, True].socket_number

    def _free_socket(self) -> int:
        """Return the socket that has been free for longest: its last owner may still send."""
        taken = {granted.socket_number for granted in self._granted.values() if granted.kept}
        turns = (self._next_socket + turn for turn in range(LEASES_MAX))
        socket_number = next(turn % LEASES_MAX for turn in turns if turn % LEASES_MAX not in taken)
        self._next_socket = socket_number + 1
        return socket_number

    def _make_room(self, now: int) -> None:
        """Remove leases that lapsed so long ago that nothing of them counts any more. Raises
        NoLease if there are still too many."""
        self._gone = {owner: until for owner, until in self._gone.items() if now < until}
        states = self._loop.commands().leases
        for key, granted in list(self._granted.items()):
            state = states.get(granted.grant.number)
            lapsed = now - granted.used_ns > LEASE_MAX_S * 1e9
            if lapsed and not granted.kept and not (state and state.fresh(now)):
                del self._granted[key]
        if len(self._granted) >= LEASES_MAX:
            raise NoLease(f"{LEASES_MAX} sources command already: one of them has to release first")

    def _publish(self) -> None:
        self._loop.grant(granted.grant for granted in self._granted.values())

    def release(self, connection: int, owner: str) -> None:
        """End the owner's lease on this connection, if there is one."""
        ended = [self._granted.pop((connection, owner, kept), None) for kept in (False, True)]
        if any(ended):
            self._publish()

    def disconnect(self, connection: int) -> None:
        """End every lease of a connection. A held source stays held on its other connections, both
        those that exist and its next one."""
        now = now_ns()
        states = self._loop.commands().leases
        ended = [key for key in self._granted if key[0] == connection]
        for key in ended:
            granted = self._granted.pop(key)
            state = states.get(granted.grant.number)
            if state is not None and state.held and state.fresh(now):
                self._bar(granted.owner, state.expires_ns)
        if ended:
            self._publish()

    def _bar(self, owner: str, until_ns: int) -> None:
        self._gone[owner] = max(self._gone.get(owner, 0), until_ns)
        for other in self._granted.values():
            if other.owner == owner:
                # Later than the time that the lease has now: the loop has to see a change.
                sent_ns = max(other.grant.barred_until_ns + 1, until_ns)
                other.grant = replace(other.grant, barred_until_ns=sent_ns)

    def holds(self, connection: int) -> bool:
        """Return whether the connection has a living command, or a lease whose token was given to
        the client. At most LEASES_MAX connections have one."""
        return any(
            granted.connection == connection and (granted.kept or self._is_fresh(granted))
            for granted in self._granted.values()
        )

    def _is_fresh(self, granted: _Granted) -> bool:
        state = self._loop.commands().leases.get(granted.grant.number)
        return state is not None and state.fresh(now_ns())

    # --------------------------------------------------------------------------------- commanding
    async def submit(
        self,
        *,
        connection: int,
        owner: str,
        priority: int,
        lease_s: float,
        linear_m_s: float,
        angular_rad_s: float,
        lateral_m_s: float = 0.0,
    ) -> Lease:
        """Send the owner's newest command, and return its lease as the loop has judged it. Raises
        ValueError for a number out of bounds, NoLease if the loop does not take the command."""
        twist = (linear_m_s, angular_rad_s, lateral_m_s)
        sideways = f" and {lateral_m_s:g} m/s sideways" if lateral_m_s != 0.0 else ""
        words = f"a command of {linear_m_s:g} m/s, {angular_rad_s:g} rad/s{sideways}"
        if not all(map(math.isfinite, twist)):
            raise ValueError(f"{words} is not finite")
        lease = await self._submit(
            (connection, owner, priority, lease_s),
            lambda token, sequence: datagram(
                token, sequence, now_ns(), linear_m_s, angular_rad_s, lateral_m_s=lateral_m_s
            ),
        )
        if any(twist) and not lease.wants_motion:
            raise NoLease(
                f"{words} is more than ten times "
                "the limit, so it counts as zero: check the unit (motord params list)"
            )
        return lease

    async def submit_joints(
        self,
        *,
        connection: int,
        owner: str,
        priority: int,
        lease_s: float,
        joint_count: int,
        velocity_rad_s: Mapping[int, float],
        position_rad: Mapping[int, float],
    ) -> Lease:
        """Send a command of joints without a base, by their places. Returns and raises as
        `submit`."""
        if not all(map(math.isfinite, (*velocity_rad_s.values(), *position_rad.values()))):
            raise ValueError("a command of joints is not finite")
        lease = await self._submit(
            (connection, owner, priority, lease_s),
            lambda token, sequence: position_datagram(
                token, sequence, now_ns(), joint_count, velocity_rad_s, position_rad
            ),
        )
        if (position_rad or any(velocity_rad_s.values())) and not lease.wants_motion:
            raise NoLease(
                "a speed or a position is more than ten times its limit, so the command counts as "
                "zero: check the unit (rad, rad/s)"
            )
        return lease

    async def _submit(
        self, source: tuple[int, str, int, float], made: Callable[[bytes, int], bytes]
    ) -> Lease:
        """Send the datagram that `made` gives for a token and a sequence number, and return the
        lease. `source`: connection, owner, priority and lease_s."""
        async with self._judging:  # one at a time: a refusal does not name its command
            grant = self.grant(*source)
            granted = self._granted[source[0], source[1], False]
            granted.sequence += 1
            before = self._loop.commands()
            try:
                self._loop.send(made(grant.token, granted.sequence))
                state = await self._judged(grant.number, granted.sequence, before)
            except (BlockingIOError, TimeoutError):
                raise NoLease("the loop takes no commands: it stands still") from None
        return _lease(granted, state)

    async def _judged(self, number: int, sequence: int, before: CommandReport) -> LeaseState:
        """Wait until the loop has taken the command, and return the state of its lease. Raises
        NoLease if the loop refuses it, TimeoutError after JUDGED_WITHIN_S."""
        async with within(JUDGED_WITHIN_S):
            while True:
                report = self._loop.commands()
                state = report.leases.get(number)
                if state is not None and state.sequence >= sequence:
                    return state
                for kind, words in _REFUSED.items():
                    if report.refused[kind] > before.refused[kind]:
                        raise NoLease(f"the command was not taken: {words}")
                await asyncio.sleep(LOOK_EVERY_S)

    # ------------------------------------------------------------------------------------ looking
    def fresh(self) -> list[Lease]:
        """Return the leases with a living command, the one in command first."""
        now = now_ns()
        states = self._loop.commands().leases
        found = (
            _lease(granted, states[granted.grant.number])
            for granted in self._granted.values()
            if granted.grant.number in states and states[granted.grant.number].fresh(now)
        )
        return sorted(found, key=lambda lease: (-lease.priority, lease.since))

    def commander(self) -> Lease | None:
        """Return the lease in command; None: no command is alive."""
        return next(iter(self.fresh()), None)

    def wanting(self) -> str | None:
        """Return the owner of a lease that requests motion, whether it is held or not; None: none
        does."""
        return next((lease.owner for lease in self.fresh() if lease.wants_motion), None)


def _lease(granted: _Granted, state: LeaseState) -> Lease:
    return Lease(
        number=granted.grant.number,
        owner=granted.owner,
        connection=granted.connection,
        priority=granted.grant.priority,
        stamp_ns=state.stamp_ns,
        expires_ns=state.expires_ns,
        since=state.since,
        rate_hz=1e9 / state.interval_ns if state.interval_ns > 0 else 0.0,
        linear_m_s=state.linear_m_s,
        angular_rad_s=state.angular_rad_s,
        lateral_m_s=state.lateral_m_s,
        held=state.held,
        wants_motion=state.wants_motion,
        joint_values_u=state.joint_values_u,
    )
