# SPDX-License-Identifier: Apache-2.0
"""The arbiter in C, with leases by connection and owner as the daemon opens them."""

from dataclasses import dataclass

from _motord_rt import ffi, lib

from motord.api.commands import RELEASE, datagram


@dataclass(frozen=True)
class Lease:
    number: int
    owner: str
    connection: int
    priority: int
    expires_ns: int
    since: int
    linear_m_s: float
    angular_rad_s: float
    held: bool
    held_ns: int

    @property
    def wants_motion(self):
        return self.linear_m_s != 0.0 or self.angular_rad_s != 0.0

    @property
    def twist(self):
        return (0.0, 0.0) if self.held else (self.linear_m_s, self.angular_rad_s)


class Arbiter:
    def __init__(self, base=ffi.NULL):
        """`base`: the core_config whose joints are commanded; NULL if no datagram names joints."""
        self.c = ffi.new("arbiter *")
        self.base = base
        lib.arbiter_init(self.c, base, ffi.NULL)
        self.granted = {}
        self.gone = {}
        self.sequence = 0
        self.now_ns = 0
        self.numbers = 0
        self.releases = 0

    def grant(self, now_ns, key, priority, lifetime_ns):
        before = self.granted.get(key)
        barred_ns = self.gone.get(key[1], 0) if before is None else before["barred_ns"]
        self.numbers += before is None
        self.granted[key] = {
            "number": self.numbers if before is None else before["number"],
            "token": bytes([self.numbers]) * 16 if before is None else before["token"],
            "priority": priority,
            "lifetime_ns": lifetime_ns,
            "barred_ns": barred_ns,
        }  # fmt: skip
        self._put_permissions()
        return self.granted[key]

    def _put_permissions(self):
        grants = list(self.granted.values())
        permissions = {"lease": grants, "releases": self.releases}
        lib.arbiter_grant(self.c, ffi.new("lease_permissions *", permissions))

    def raw(self, now_ns, datagram_bytes):
        self.now_ns, may_move = now_ns, True
        return lib.arbiter_submit(self.c, datagram_bytes, len(datagram_bytes), now_ns, may_move)

    def submit(self, now_ns, *, owner, connection, priority, lease_s, linear_m_s):
        key = connection, owner
        grant = self.grant(now_ns, key, priority, round(lease_s * 1e9))
        self.sequence += 1
        command = datagram(grant["token"], self.sequence, now_ns, linear_m_s, 0.0)
        self.raw(now_ns, command)
        return next(lease for lease in self.all() if (lease.connection, lease.owner) == key)

    def all(self):
        by_number = {grant["number"]: key for key, grant in self.granted.items()}
        return [
            Lease(
                number=raw.number,
                owner=by_number[raw.number][1],
                connection=by_number[raw.number][0],
                priority=raw.priority,
                expires_ns=raw.expires_ns,
                since=raw.since,
                linear_m_s=raw.linear_m_s,
                angular_rad_s=raw.angular_rad_s,
                held=raw.held != 0,
                held_ns=raw.held_ns,
            )
            for raw in self.c.report.lease
            if raw.number
        ]

    def leases(self, now_ns):
        fresh = [lease for lease in self.all() if now_ns < lease.expires_ns]
        return sorted(fresh, key=lambda lease: (-lease.priority, lease.since))

    def command(self, now_ns, may_move=True):
        self.now_ns = now_ns
        out = ffi.new("twist_command *")
        lib.arbiter_command(self.c, now_ns, may_move, out)
        return out

    def commander(self, now_ns):
        """Return the lease that C reports as commander, or None; check the core's twist."""
        out = self.command(now_ns)
        number = self.c.report.commander
        found = next((lease for lease in self.all() if lease.number == number), None)
        assert (found is None) == (number == 0)
        if found is not None:
            assert (out.linear_m_s, out.angular_rad_s) == found.twist
            assert out.expires_ns == found.expires_ns > now_ns
        else:
            assert (out.linear_m_s, out.angular_rad_s) == (0.0, 0.0)
            assert out.expires_ns <= now_ns
        return found

    def release(self, connection, owner):
        grant = self.granted.get((connection, owner))
        if grant is not None:
            self.raw(self.now_ns, datagram(grant["token"], 0, 0, 0.0, 0.0, kind=RELEASE))

    def disconnect(self, connection):
        for lease in self.all():
            if lease.connection == connection:
                del self.granted[connection, lease.owner]
                if lease.held:
                    self.bar(lease.owner, lease.held_ns)
        self._put_permissions()

    def bar(self, owner, held_ns):
        self.gone[owner] = max(held_ns, self.gone.get(owner, 0))
        for (_, other), grant in self.granted.items():
            if other == owner:
                grant["barred_ns"] = max(grant["barred_ns"] + 1, held_ns)

    def release_all(self):
        """Let all held leases go on, as a person does."""
        self.gone.clear()
        for grant in self.granted.values():
            grant["barred_ns"] = 0
        self.releases += 1
        self._put_permissions()
