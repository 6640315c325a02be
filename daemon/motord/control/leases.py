# SPDX-License-Identifier: Apache-2.0
"""Leases, the right of sources to command, by connection and owner. Python starts and ends them.
The loop (csrc/loop/command/arbiter.c) decides which of them is in command and which is held, and
reports it.

The fresh lease with the highest priority commands; among equals the first one. A source whose last
request is motion while nothing may move is held: its lease counts as zero until the source sends
zero, ends its lease, is started anew, or a person lets it go on. Silence ends no hold, and neither
does a new connection."""

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
from motord.control.holds import Holds, Left
from motord.local_socket.peer_process import Process
from motord.realtime.loop import LEASE_NUMBERS, LEASES_MAX, SOURCE_SILENT_S, Loop
from motord_hal.base.clock import within
from motord_hal.realtime.exchange import now_ns

LEASE_MIN_S = 0.02
LEASE_MAX_S = float(SOURCE_SILENT_S)
JUDGED_WITHIN_S = 0.5
LOOK_EVERY_S = 0.0005
SPARSE_FROM = 3
"""Commands in a row that came too late for their lease: then its source sends too seldom."""
_REFUSED = {
    Refusal.AGE: "it took longer than its lifetime to get to the loop",
    Refusal.NOT_FINITE: "it is not finite",
}


HELD_SINCE = "it requested motion when the robot could not move, and has not sent zero since"
RELEASES = (
    "It moves the robot again when it sends zero once (each sender of it; over MQTT zero, and no "
    f"motion for {SOURCE_SILENT_S} s after it), when its program is started anew after "
    f"{SOURCE_SILENT_S} s of silence, or when a person runs motord arm while the robot is armed "
    f"(or, if it is silent for {SOURCE_SILENT_S} s, arms the robot)"
)


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
    """Whether the command counts as zero: see `Held`."""
    wants_motion: bool
    """Whether a value other than zero was requested, held or not."""
    joint_values_u: Mapping[int, float]
    """Requested values by the joint's place in the robot file, in the units of `LeaseState`."""

    sparse: str
    """That commands come less often than their lease, in words; empty: they do not."""

    @property
    def why_held(self) -> str:
        return f"{self.owner} is held: {HELD_SINCE}. {RELEASES}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """A source that moves nothing, whether it sends commands at present or not."""

    owner: str
    since_ns: int
    """When it was held, CLOCK_MONOTONIC."""
    taken_ns: int
    """When its newest command came; 0: its connection has ended."""


@dataclass(slots=True)
class _Granted:
    owner: str
    connection: int
    process: Process | None
    grant: LeaseGrant
    used_ns: int
    kept: bool
    """Whether its token was given to the client: then it ends with its connection, not by
    lapsing."""
    serial: bool = False
    """See `Left.serial`."""
    socket_number: int = 0
    """Number of its own command socket (of LEASES_MAX), if its token was given to the client."""
    sequence: int = 0


class Leases:
    """All leases of the daemon."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._granted: dict[tuple[int, str, bool], _Granted] = {}
        """Leases by connection, owner, and whether the token was given to the client."""
        self._holds = Holds()
        self._releases = 0
        self._may_move = True
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
        process: Process | None = None,
    ) -> LeaseGrant:
        """Make or renew the owner's lease on this connection. `process`: the source's own, which
        may be started anew; None: not known, or it passes on the commands of others. Raises
        ValueError for a lifetime out of bounds, NoLease if there are too many leases."""
        if not LEASE_MIN_S <= lease_s <= LEASE_MAX_S:
            raise ValueError(f"lease_s is {lease_s}: {LEASE_MIN_S} to {LEASE_MAX_S} s")
        now = now_ns()
        lifetime_ns = round(lease_s * 1e9)
        before = self._granted.get((connection, owner, kept))
        if before is None:
            self._make_room(now)
            grant = LeaseGrant(
                number=next(LEASE_NUMBERS),
                token=secrets.token_bytes(TOKEN_BYTES),
                priority=priority,
                lifetime_ns=lifetime_ns,
                interval_least_ns=round(1e9 / rate_max_hz) if rate_max_hz else 0,
                barred_ns=self._holds.since_ns(owner, process, now),
            )
            before = _Granted(
                owner, connection, process, grant, now, kept,
                serial=self._holds.follows(owner, process, now), socket_number=self._free_socket(),
            )  # fmt: skip
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
        states = self._loop.commands().leases
        for key, granted in list(self._granted.items()):
            state = states.get(granted.grant.number)
            lapsed = now - granted.used_ns > LEASE_MAX_S * 1e9
            if lapsed and not granted.kept and not (state and state.fresh(now)):
                self._leave(self._granted.pop(key), state)
        if len(self._granted) >= LEASES_MAX:
            raise NoLease(f"{LEASES_MAX} sources command already: one of them has to release first")

    def _publish(self) -> None:
        self._loop.grant((granted.grant for granted in self._granted.values()), self._releases)

    def release(self, connection: int, owner: str) -> None:
        """End the owner's lease on this connection, if there is one."""
        ended = [self._granted.pop((connection, owner, kept), None) for kept in (False, True)]
        states = self._loop.commands().leases
        for granted in filter(None, ended):
            self._end(granted, states.get(granted.grant.number))
        if any(ended):
            self._publish()

    def disconnect(self, connection: int) -> None:
        """End every lease of a connection. A held source stays held on its other connections, both
        those that exist and its next one."""
        states = self._loop.commands().leases
        ended = [key for key in self._granted if key[0] == connection]
        for key in ended:
            granted = self._granted.pop(key)
            self._leave(granted, states.get(granted.grant.number))
        if ended:
            self._publish()

    # -------------------------------------------------------------------------------------- holding
    def _leave(self, granted: _Granted, state: LeaseState | None) -> None:
        """Note what a lease leaves behind that ends without the source's own word. Publish
        afterwards."""
        if state is None or not (state.senders_held or state.open):
            self._end(granted, state)
            return
        stopped_ns = 0 if self._may_move else now_ns()
        since_ns = state.held_ns if state.senders_held else stopped_ns
        self._holds.note(
            granted.owner,
            Left(since_ns=since_ns, newest_ns=state.taken_ns, process=granted.process),
        )
        if since_ns > 0:
            self._bar(granted.owner)

    def _end(self, granted: _Granted, state: LeaseState | None) -> None:
        """Note a source that has ended its request: another process of it may follow at once."""
        if state is None or state.sequence == 0 or granted.process is None:
            return
        self._holds.note_end(
            granted.owner,
            Left(
                since_ns=state.held_ns if state.senders_held else 0,
                newest_ns=state.taken_ns,
                process=granted.process,
                ended=True,
                serial=granted.serial,
            ),
        )

    def _bar(self, owner: str) -> None:
        for other in self._granted.values():
            since_ns = self._holds.since_ns(owner, other.process, now_ns())
            if other.owner == owner and since_ns > 0:
                # Later than the time that the lease has now: the loop has to see a change.
                sent_ns = max(other.grant.barred_ns + 1, since_ns)
                other.grant = replace(other.grant, barred_ns=sent_ns)

    def follow(self, *, may_move: bool, armed: bool = False) -> None:
        """Follow the state machine: whether sources may move the robot, and whether it was armed
        now, which lets those go on that have been silent for long. The loop does the same with
        leases that exist."""
        if self._may_move and not may_move and (owners := self._holds.stop(now_ns())):
            for owner in owners:
                self._bar(owner)
            self._publish()
        self._may_move = may_move
        if armed:
            self._holds.arm(now_ns())

    def release_held(self) -> tuple[str, ...]:
        """Let all held sources go on, as a person decides; return their owners."""
        owners = tuple(dict.fromkeys(one.owner for one in self.held()))
        if owners:
            self._holds.clear()
            for granted in self._granted.values():
                granted.grant = replace(granted.grant, barred_ns=0)
            self._releases += 1
            self._publish()
        return owners

    def held(self) -> list[Held]:
        """Return the held sources, also those that are silent or not connected at present."""
        states = self._loop.commands().leases
        found = []
        for granted in self._granted.values():
            state = states.get(granted.grant.number)
            if state is not None and state.senders_held:
                held = Held(owner=granted.owner, since_ns=state.held_ns, taken_ns=state.taken_ns)
                found.append(held)
            elif state is not None and granted.grant.barred_ns > 0 and state.sequence > 0:
                self._holds.forget(granted.owner)  # it was held, and has sent zero
        known = {one.owner for one in found}
        gone = (
            Held(owner=owner, since_ns=left.since_ns, taken_ns=0)
            for owner, left in self._holds.held(now_ns())
            if owner not in known
        )
        return [*found, *gone]

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
        process: Process | None = None,
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
            (connection, owner, priority, lease_s, process),
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
        process: Process | None = None,
        joint_count: int,
        velocity_rad_s: Mapping[int, float],
        position_rad: Mapping[int, float],
        clamp: bool = False,
        beyond: str = "",
    ) -> Lease:
        """Send a command of joints without a base, by their places. `beyond`: which positions are
        beyond their ranges, in words; `clamp`: they mean the ends. Returns and raises as
        `submit`."""
        if not all(map(math.isfinite, (*velocity_rad_s.values(), *position_rad.values()))):
            raise ValueError("a command of joints is not finite")
        lease = await self._submit(
            (connection, owner, priority, lease_s, process),
            lambda token, sequence: position_datagram(
                token, sequence, now_ns(), joint_count, velocity_rad_s, position_rad, clamp=clamp
            ),
        )
        if (position_rad or any(velocity_rad_s.values())) and not lease.wants_motion:
            raise NoLease(
                f"{beyond or 'a speed is more than ten times its limit'}: the command counts as "
                f"zero. Check the unit (rad, rad/s){', or set clamp' if beyond else ''}"
            )
        return lease

    async def _submit(
        self,
        source: tuple[int, str, int, float, Process | None],
        made: Callable[[bytes, int], bytes],
    ) -> Lease:
        """Send the datagram that `made` gives for a token and a sequence number, and return the
        lease. `source`: connection, owner, priority, lease_s and process."""
        async with self._judging:  # one at a time: a refusal does not name its command
            grant = self.grant(*source[:4], process=source[4])
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

    def numbers(self) -> set[int]:
        """Return the numbers of all leases."""
        return {granted.grant.number for granted in self._granted.values()}

    def sparse(self) -> dict[int, str]:
        """Return the sources whose commands come less often than their lease, in words, by the
        lease's number."""
        states = self._loop.commands().leases
        found = {
            granted.grant.number: _sparse(granted, states[granted.grant.number])
            for granted in self._granted.values()
            if granted.grant.number in states
        }
        return {number: words for number, words in found.items() if words}

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
        sparse=_sparse(granted, state),
    )


def _sparse(granted: _Granted, state: LeaseState) -> str:
    if state.lapses < SPARSE_FROM:
        return ""
    return (
        f"{granted.owner} sends a command every {state.interval_ns / 1e9:.2f} s, but each one ends "
        f"after {granted.grant.lifetime_ns / 1e9:g} s: the robot comes to rest in between. Send "
        "more often, or give it a longer lease_s"
    )
