# SPDX-License-Identifier: Apache-2.0
"""Who is in command: leases, and the rule that picks one. No clock inside: every call is told the
time (CLOCK_MONOTONIC, ns).

The fresh lease with the highest priority commands; among equals the one who came first. A lease
belongs to a connection and an owner in it, and lives only as long as it is renewed: with each
command, for its own lifetime. Who asks for motion while nobody may move is held: his lease says
zero until he has asked for zero himself or has let it lapse. So a source that goes on sending
through a stop, or before arming, moves nothing, also when it connects anew for each command.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

LEASE_MIN_S = 0.02
LEASE_MAX_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """A source's right to command, and its newest command."""

    number: int
    """Grows with each new lease, from 1; a renewal keeps it."""
    owner: str
    connection: int
    priority: int
    stamp_ns: int
    """When the newest command came."""
    expires_ns: int
    linear_m_s: float
    angular_rad_s: float
    held: bool
    """Its command counts as zero until zero was asked for."""

    @property
    def wants_motion(self) -> bool:
        """Something else than zero was asked for, held or not."""
        return self.linear_m_s != 0.0 or self.angular_rad_s != 0.0

    @property
    def twist(self) -> tuple[float, float]:
        """What may be commanded under it: m/s and rad/s."""
        return (0.0, 0.0) if self.held else (self.linear_m_s, self.angular_rad_s)


class Arbiter:
    """All leases of the daemon."""

    def __init__(self) -> None:
        self._leases: dict[tuple[int, str], Lease] = {}
        self._gone: dict[str, int] = {}
        """Owners that were held when their connection ended, and when their lease would have."""
        self._numbers = itertools.count(1)

    def submit(
        self,
        now_ns: int,
        *,
        owner: str,
        connection: int,
        priority: int,
        lease_s: float,
        linear_m_s: float,
        angular_rad_s: float,
        may_move: bool,
    ) -> Lease:
        """The owner's newest command: makes or renews his lease. ValueError says what is wrong with
        a number; then nothing has changed."""
        if not (math.isfinite(linear_m_s) and math.isfinite(angular_rad_s)):
            raise ValueError(f"a command of {linear_m_s} m/s, {angular_rad_s} rad/s is not finite")
        if not LEASE_MIN_S <= lease_s <= LEASE_MAX_S:
            raise ValueError(f"lease_s is {lease_s}: {LEASE_MIN_S} to {LEASE_MAX_S} s")
        key = connection, owner
        before = self._leases.get(key)
        if before is not None and now_ns >= before.expires_ns:
            before = None
        still = linear_m_s == 0.0 and angular_rad_s == 0.0
        gone_until_ns = self._gone.pop(owner, 0)
        barred = now_ns < gone_until_ns if before is None else before.held
        held = not still and (not may_move or barred)
        lease = Lease(
            number=next(self._numbers) if before is None else before.number,
            owner=owner,
            connection=connection,
            priority=priority,
            stamp_ns=now_ns,
            expires_ns=now_ns + round(lease_s * 1e9),
            linear_m_s=linear_m_s,
            angular_rad_s=angular_rad_s,
            held=held,
        )
        self._leases[key] = lease
        return lease

    def release(self, connection: int, owner: str) -> None:
        """The owner gives his lease back; no lease: nothing."""
        self._leases.pop((connection, owner), None)

    def disconnect(self, connection: int) -> None:
        """Every lease of a connection ends with it. Who is held stays so on his next connection."""
        for key, lease in list(self._leases.items()):
            if key[0] == connection:
                del self._leases[key]
                if lease.held:
                    until_ns = self._gone.get(lease.owner, 0)
                    self._gone[lease.owner] = max(until_ns, lease.expires_ns)

    def hold(self) -> None:
        """Stop: everybody who asks for motion is held."""
        for key, lease in self._leases.items():
            self._leases[key] = replace(lease, held=lease.wants_motion)

    def leases(self, now_ns: int) -> list[Lease]:
        """The fresh ones, who commands first; what has lapsed is forgotten."""
        self._gone = {owner: until for owner, until in self._gone.items() if now_ns < until}
        self._leases = {
            key: lease for key, lease in self._leases.items() if now_ns < lease.expires_ns
        }
        return sorted(self._leases.values(), key=lambda lease: (-lease.priority, lease.number))

    def commander(self, now_ns: int) -> Lease | None:
        """Whose command counts now."""
        return next(iter(self.leases(now_ns)), None)

    def wanting(self, now_ns: int) -> str | None:
        """Somebody who asks for motion, whether it is granted or not."""
        return next((lease.owner for lease in self.leases(now_ns) if lease.wants_motion), None)
