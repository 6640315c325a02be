# SPDX-License-Identifier: Apache-2.0
"""Leases in the loop, for any behaviour of sources."""

import struct

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from tests.rt.arbiter_rig import Arbiter

MS = 1_000_000
START_NS = 5_000_000_000


@given(data=st.binary(min_size=64, max_size=64))
def test_no_datagram_without_the_token_commands(data):
    arbiter = Arbiter()
    arbiter.grant(START_NS, (1, "teleop"), 100, 300 * MS)
    magic = struct.pack("<IHH", 0x434D544D, 1, 1)
    assert arbiter.raw(START_NS, magic + data[8:]) != 0
    assert arbiter.commander(START_NS) is None


KEYS = {"connection": st.integers(1, 3), "owner": st.sampled_from("ab")}


class Sources(RuleBasedStateMachine):
    """For any behaviour of sources, the commander is the first of the highest priority, and
    nothing outlives its lease or passes a stop."""

    def __init__(self):
        super().__init__()
        self.arbiter = Arbiter()
        self.now_ns = START_NS
        self.stopped = set()
        """Leases that have requested motion without a break since the last stop: held at zero."""
        self.left = {}
        """Owners whose connection ended while their lease was held → when that lease would expire,
        ns: until then the owner's next lease is barred from motion."""
        self.sent = {}
        """Each lease that has sent a command → the time until which it is barred, ns; 0: never."""
        self.barred = set()
        """Leases that have sent nothing since they were barred."""

    @rule(**KEYS, priority=st.integers(0, 3), lease_ms=st.integers(20, 5000),
          linear_m_s=st.sampled_from([0.0, -0.0, 0.5, 1e300]))  # fmt: skip
    def command(self, connection, owner, priority, lease_ms, linear_m_s):
        key = connection, owner
        fresh = key in self.fresh()
        left_ns = self.left.pop(owner, 0)
        if key not in self.sent:
            self.sent[key] = left_ns
            self.barred.add(key)
        left = key in self.barred and self.now_ns < self.sent[key]
        self.barred.discard(key)
        lease = self.arbiter.submit(
            self.now_ns, owner=owner, connection=connection, priority=priority,
            lease_s=lease_ms / 1000, linear_m_s=linear_m_s,
        )  # fmt: skip
        if not fresh or linear_m_s == 0.0:
            self.stopped.discard(key)
        if not fresh and left and linear_m_s != 0.0:
            self.stopped.add(key)
        if key in self.stopped:
            assert lease.twist == (0.0, 0.0)
        else:
            assert lease.twist == (linear_m_s, 0.0)

    @rule(**KEYS)
    def release(self, connection, owner):
        self.arbiter.release(connection, owner)
        assert (connection, owner) not in self.fresh()

    @rule(connection=st.integers(1, 3))
    def disconnect(self, connection):
        ended = {key: lease for key, lease in self.fresh().items() if key[0] == connection}
        self.sent = {key: sent for key, sent in self.sent.items() if key[0] != connection}
        self.barred &= set(self.sent)
        for lease in (lease for key, lease in ended.items() if key in self.stopped):
            self.left[lease.owner] = max(lease.expires_ns, self.left.get(lease.owner, 0))
            for key in self.sent:
                if key[1] == lease.owner:
                    self.sent[key] = max(lease.expires_ns, self.sent[key] + 1)
                    self.barred.add(key)
        self.arbiter.disconnect(connection)
        assert not any(key[0] == connection for key in self.fresh())

    @rule()
    def stop(self):
        self.arbiter.command(self.now_ns, may_move=False)
        self.stopped = {key for key, lease in self.fresh().items() if lease.wants_motion}
        assert all(lease.twist == (0.0, 0.0) for lease in self.arbiter.leases(self.now_ns))
        assert self.arbiter.commander(self.now_ns) in (None, *self.arbiter.leases(self.now_ns))

    @rule(ms=st.integers(0, 400))
    def wait(self, ms):
        self.now_ns += ms * MS

    def fresh(self):
        return {(x.connection, x.owner): x for x in self.arbiter.leases(self.now_ns)}

    @invariant()
    def the_first_of_the_highest_commands(self):
        leases = self.arbiter.leases(self.now_ns)
        first = self.arbiter.commander(self.now_ns)
        assert (first is None) == (not leases)
        for lease in leases:
            assert self.now_ns < lease.expires_ns
            assert first.priority > lease.priority or (
                first.priority == lease.priority and first.since <= lease.since
            )


TestSources = Sources.TestCase
