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
    """For any behaviour of sources, the commander is the first of the highest priority, nothing
    outlives its lease, and after a stop nothing moves for a source that has sent no zero since."""

    def __init__(self):
        super().__init__()
        self.arbiter = Arbiter()
        self.now_ns = START_NS
        self.open = set()
        """Leases whose last word is motion, however long ago."""
        self.stopped = set()
        """Leases that are held: a stop came after that word."""
        self.left = set()
        """Owners whose connection ended while they were held: their next leases are held."""

    @rule(**KEYS, priority=st.integers(0, 3), lease_ms=st.integers(20, 5000),
          linear_m_s=st.sampled_from([0.0, -0.0, 0.5, 1e300]))  # fmt: skip
    def command(self, connection, owner, priority, lease_ms, linear_m_s):
        key = connection, owner
        if key not in self.arbiter.granted and owner in self.left:
            self.stopped.add(key)
        lease = self.arbiter.submit(
            self.now_ns, owner=owner, connection=connection, priority=priority,
            lease_s=lease_ms / 1000, linear_m_s=linear_m_s,
        )  # fmt: skip
        if linear_m_s == 0.0:
            self.stopped.discard(key)
            self.open.discard(key)
        else:
            self.open.add(key)
        assert lease.held == (key in self.stopped)
        assert lease.twist == (0.0 if key in self.stopped else linear_m_s, 0.0)

    @rule(**KEYS)
    def release(self, connection, owner):
        self.arbiter.release(connection, owner)
        self.open.discard((connection, owner))
        if (connection, owner) in self.arbiter.granted:
            self.stopped.discard((connection, owner))
        assert (connection, owner) not in self.fresh()

    @rule(connection=st.integers(1, 3))
    def disconnect(self, connection):
        self.arbiter.disconnect(connection)
        ended = {key for key in self.stopped if key[0] == connection}
        self.open = {key for key in self.open if key[0] != connection}
        self.stopped -= ended
        self.left |= {owner for _, owner in ended}
        self.stopped |= {
            key for key in self.arbiter.granted if key[1] in {owner for _, owner in ended}
        }
        assert not any(key[0] == connection for key in self.fresh())

    @rule()
    def stop(self):
        self.arbiter.command(self.now_ns, may_move=False)
        self.stopped |= self.open
        assert all(lease.twist == (0.0, 0.0) for lease in self.arbiter.leases(self.now_ns))
        assert self.arbiter.commander(self.now_ns) in (None, *self.arbiter.leases(self.now_ns))

    @rule()
    def released(self):
        self.arbiter.release_all()
        self.stopped.clear()
        self.left.clear()

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
        held = {(one.connection, one.owner) for one in self.arbiter.all() if one.held}
        assert held == self.stopped
        for lease in leases:
            assert self.now_ns < lease.expires_ns
            assert first.priority > lease.priority or (
                first.priority == lease.priority and first.since <= lease.since
            )


TestSources = Sources.TestCase


def test_a_released_hold_counts_again_at_the_same_time():
    state = Sources()
    for connection in (1, 2):
        state.command(connection, "a", 0, 20, 0.5)
        state.stop()
        state.disconnect(connection)
        state.the_first_of_the_highest_commands()
        state.command(1, "a", 0, 20, 0.0)
        state.released()
        state.the_first_of_the_highest_commands()
