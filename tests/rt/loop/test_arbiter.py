# SPDX-License-Identifier: Apache-2.0
"""Leases, as the loop judges them: who commands, when they lapse, who takes over."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from tests.rt.arbiter_rig import Arbiter

from motord.api.commands import Refusal, datagram

MS = 1_000_000
START_NS = 5_000_000_000


def submit(arbiter, at_ms, owner="teleop", **changes):
    command = {
        "connection": 1, "priority": 100, "lease_s": 0.3,
        "linear_m_s": 0.5, "angular_rad_s": 0.1, "may_move": True,
    }  # fmt: skip
    return arbiter.submit(START_NS + at_ms * MS, owner=owner, **(command | changes))


def commander(arbiter, at_ms):
    lease = arbiter.commander(START_NS + at_ms * MS)
    return None if lease is None else lease.owner


def test_nothing_commands_before_the_first_command():
    assert commander(Arbiter(), 0) is None


def test_a_lease_lapses_at_its_end_and_not_before():
    arbiter = Arbiter()
    submit(arbiter, 0, lease_s=0.3)
    assert commander(arbiter, 299) == "teleop"
    assert commander(arbiter, 300) is None


def test_each_command_renews_the_lease_and_replaces_the_one_before():
    arbiter = Arbiter()
    first = submit(arbiter, 0, linear_m_s=0.1)
    second = submit(arbiter, 200, linear_m_s=0.2)
    assert second.number == first.number
    assert arbiter.commander(START_NS + 400 * MS) == second
    assert len(arbiter.leases(START_NS + 400 * MS)) == 1


def test_the_higher_priority_takes_over_and_gives_back_when_it_lapses():
    arbiter = Arbiter()
    submit(arbiter, 0, "planner", connection=1, priority=10, lease_s=1.0)
    submit(arbiter, 100, "joystick", connection=2, priority=50, lease_s=0.2)
    assert commander(arbiter, 299) == "joystick"
    assert commander(arbiter, 300) == "planner"


def test_the_higher_priority_gives_back_when_it_releases():
    arbiter = Arbiter()
    submit(arbiter, 0, "planner", connection=1, priority=10)
    submit(arbiter, 0, "joystick", connection=2, priority=50)
    arbiter.release(2, "joystick")
    assert commander(arbiter, 1) == "planner"


def test_among_equals_the_earlier_holder_keeps_the_command():
    arbiter = Arbiter()
    submit(arbiter, 0, "first", connection=1)
    submit(arbiter, 10, "second", connection=2)
    submit(arbiter, 20, "second", connection=2)
    assert commander(arbiter, 30) == "first"


def test_who_let_the_lease_lapse_queues_up_behind():
    arbiter = Arbiter()
    submit(arbiter, 0, "first", connection=1, lease_s=0.1)
    submit(arbiter, 10, "second", connection=2, lease_s=1.0)
    submit(arbiter, 150, "first", connection=1)
    assert commander(arbiter, 200) == "second"


def test_two_connections_with_the_same_owner_do_not_share_a_lease():
    arbiter = Arbiter()
    submit(arbiter, 0, "socket", connection=1, linear_m_s=0.1)
    submit(arbiter, 10, "socket", connection=2, linear_m_s=0.9)
    lease = arbiter.commander(START_NS + 20 * MS)
    assert (lease.connection, lease.linear_m_s) == (1, 0.1)


def test_leases_end_with_their_connection():
    arbiter = Arbiter()
    submit(arbiter, 0, "a", connection=1)
    submit(arbiter, 0, "b", connection=1)
    submit(arbiter, 0, "c", connection=2)
    arbiter.disconnect(1)
    assert [lease.owner for lease in arbiter.leases(START_NS)] == ["c"]


def test_a_release_of_something_elses_lease_does_nothing():
    arbiter = Arbiter()
    submit(arbiter, 0, "a", connection=1)
    arbiter.release(2, "a")
    arbiter.release(1, "b")
    assert commander(arbiter, 1) == "a"


def test_a_source_that_goes_on_sending_through_a_stop_moves_nothing():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    assert arbiter.commander(START_NS).twist == (0.0, 0.0)
    for at_ms in range(0, 2000, 50):
        assert submit(arbiter, at_ms).twist == (0.0, 0.0)
    assert arbiter.wanting(START_NS + 2000 * MS) == "teleop"


def test_after_a_stop_zero_lifts_the_hold():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    submit(arbiter, 50, linear_m_s=0.0, angular_rad_s=0.0)
    assert submit(arbiter, 100).twist == (0.5, 0.1)


def test_after_a_stop_silence_for_a_lease_lifts_the_hold():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    assert submit(arbiter, 300).twist == (0.5, 0.1)


def test_a_source_that_requests_motion_before_arming_is_held_after_it():
    arbiter = Arbiter()
    submit(arbiter, 0, may_move=False)
    assert submit(arbiter, 100, may_move=True).twist == (0.0, 0.0)


def test_who_sent_zero_before_arming_drives_at_once():
    arbiter = Arbiter()
    submit(arbiter, 0, linear_m_s=0.0, angular_rad_s=-0.0, may_move=False)
    assert arbiter.wanting(START_NS) is None
    assert submit(arbiter, 100, may_move=True).twist == (0.5, 0.1)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", ["linear_m_s", "angular_rad_s"])
def test_what_is_not_finite_is_refused_and_the_lease_commands_zero(which, value):
    arbiter = Arbiter()
    submit(arbiter, 0)
    submit(arbiter, 10, **{which: value})
    assert arbiter.refusal == 1 + Refusal.NOT_FINITE
    assert arbiter.commander(START_NS + 10 * MS).twist == (0.0, 0.0)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_no_zero_that_would_lift_a_hold(value):
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    submit(arbiter, 10, linear_m_s=value)
    assert submit(arbiter, 20).twist == (0.0, 0.0)


def raw(arbiter, at_ms, **changes):
    """One datagram of the lease that `submit` has made, and what came of it; None: taken."""
    grant = next(iter(arbiter.granted.values()))
    command = {
        "token": grant["token"], "sequence": 100, "stamp_ns": START_NS + at_ms * MS,
        "linear_m_s": 0.7, "angular_rad_s": 0.0,
    }  # fmt: skip
    code = arbiter.raw(START_NS + at_ms * MS, datagram(**(command | changes)))
    return None if code == 0 else Refusal(code - 1)


@pytest.mark.parametrize(
    ("why", "changes"),
    [
        (Refusal.TOKEN, {"token": bytes(16)}),
        (Refusal.TOKEN, {"token": b"x" * 16}),
        (Refusal.SEQUENCE, {"sequence": 1}),
        (Refusal.SEQUENCE, {"sequence": 0}),
        (Refusal.SEQUENCE, {"sequence": (1 << 63) + 1}),
        (Refusal.AGE, {"stamp_ns": 0}),
        (Refusal.AGE, {"stamp_ns": -(2**63)}),
        (Refusal.AGE, {"stamp_ns": 2**63 - 1}),
        (Refusal.AGE, {"stamp_ns": START_NS - 300 * MS}),
        (Refusal.AGE, {"stamp_ns": START_NS + 11 * MS}),
        (Refusal.LIFETIME, {"lifetime_ms": 301}),
        (Refusal.LIFETIME, {"lifetime_ms": 19}),
        (Refusal.FORM, {"kind": 0}),
        (Refusal.FORM, {"kind": 3}),
    ],
)
def test_what_is_refused_changes_nothing_and_is_counted(why, changes):
    arbiter = Arbiter()
    before = submit(arbiter, 0)
    assert raw(arbiter, 0, **changes) is why
    assert arbiter.commander(START_NS) == before
    assert arbiter.c.report.refused[why] == 1
    assert sum(arbiter.c.report.refused) == 1


@pytest.mark.parametrize("size", [0, 1, 63, 65])
def test_a_datagram_of_another_length_is_refused(size):
    arbiter = Arbiter()
    submit(arbiter, 0)
    assert arbiter.raw(START_NS, bytes(size)) == 1 + Refusal.FORM


def test_another_magic_or_version_is_refused():
    arbiter = Arbiter()
    submit(arbiter, 0)
    grant = next(iter(arbiter.granted.values()))
    good = bytearray(datagram(grant["token"], 100, START_NS, 0.1, 0.0))
    for place in (0, 4):
        bad = bytearray(good)
        bad[place] ^= 1
        assert arbiter.raw(START_NS, bytes(bad)) == 1 + Refusal.FORM
    assert arbiter.raw(START_NS, bytes(good)) == 0


@given(data=st.binary(min_size=64, max_size=64))
def test_no_datagram_without_the_token_commands(data):
    arbiter = Arbiter()
    before = submit(arbiter, 0)
    magic = struct.pack("<IHH", 0x434D544D, 1, 1)
    assert arbiter.raw(START_NS, magic + data[8:]) != 0
    assert arbiter.commander(START_NS) == before


def test_a_lifetime_of_its_own_is_shorter_than_the_leases():
    arbiter = Arbiter()
    submit(arbiter, 0)
    assert raw(arbiter, 10, lifetime_ms=20) is None
    assert commander(arbiter, 29) == "teleop"
    assert commander(arbiter, 30) is None


def test_a_command_that_was_in_transit_for_long_lives_no_longer_for_it():
    arbiter = Arbiter()
    submit(arbiter, 0)
    assert raw(arbiter, 200, stamp_ns=START_NS + 10 * MS) is None
    assert commander(arbiter, 309) == "teleop"
    assert commander(arbiter, 310) is None


def test_a_sequence_goes_on_past_the_end_of_its_64_bits():
    arbiter = Arbiter()
    submit(arbiter, 0)
    assert raw(arbiter, 10, sequence=(1 << 63)) is None
    assert raw(arbiter, 20, sequence=(1 << 64) - 1) is None
    assert raw(arbiter, 30, sequence=5) is None
    assert raw(arbiter, 40, sequence=(1 << 64) - 1) is Refusal.SEQUENCE


def test_a_sequence_of_zero_is_a_replay_also_after_the_end_of_the_64_bits():
    arbiter = Arbiter()
    submit(arbiter, 0)
    assert raw(arbiter, 10, sequence=(1 << 63)) is None
    assert raw(arbiter, 20, sequence=(1 << 64) - 1, linear_m_s=0.3) is None
    assert raw(arbiter, 30, sequence=0, linear_m_s=0.9) is Refusal.SEQUENCE
    assert arbiter.commander(START_NS + 30 * MS).linear_m_s == 0.3
    assert raw(arbiter, 40, sequence=7 << 61) is Refusal.SEQUENCE
    assert raw(arbiter, 50, sequence=1) is None


def test_a_held_source_is_held_on_its_next_connection_until_its_lease_has_lapsed():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    arbiter.disconnect(1)
    assert submit(arbiter, 100, connection=2).held
    arbiter.disconnect(2)
    assert not submit(arbiter, 400, connection=3).held


def test_a_held_source_is_free_on_its_next_connection_when_it_has_sent_zero():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    arbiter.disconnect(1)
    submit(arbiter, 100, connection=2, linear_m_s=0.0, angular_rad_s=0.0)
    assert not submit(arbiter, 150, connection=2).held


def test_who_was_held_is_held_on_the_connection_that_he_has_already():
    arbiter = Arbiter()
    submit(arbiter, 0, connection=2, lease_s=0.02, linear_m_s=0.0)
    submit(arbiter, 50, connection=1)
    arbiter.hold()
    arbiter.disconnect(1)
    assert submit(arbiter, 100, connection=2).held
    assert not submit(arbiter, 500, connection=2).held


def test_a_bar_that_was_lifted_does_not_come_back_when_others_are_granted():
    arbiter = Arbiter()
    submit(arbiter, 0, lease_s=5.0)
    arbiter.hold()
    arbiter.disconnect(1)
    submit(arbiter, 10, connection=2, lease_s=0.02, linear_m_s=0.0, angular_rad_s=0.0)
    submit(arbiter, 20, "other", connection=3)
    assert not submit(arbiter, 100, connection=2).held


def test_a_second_bar_counts_though_it_ends_before_the_first_one_did():
    arbiter = Arbiter()
    submit(arbiter, 0, lease_s=5.0)
    arbiter.hold()
    arbiter.disconnect(1)
    submit(arbiter, 10, connection=2, lease_s=0.02, linear_m_s=0.0, angular_rad_s=0.0)
    submit(arbiter, 20, connection=3, lease_s=0.3)
    arbiter.hold()
    arbiter.disconnect(3)
    assert submit(arbiter, 100, connection=2).held


KEYS = {"connection": st.integers(1, 3), "owner": st.sampled_from("ab")}


class Sources(RuleBasedStateMachine):
    """Whatever sources do: the commander is the first of the highest, and nothing outlives its
    lease or passes a stop."""

    def __init__(self):
        super().__init__()
        self.arbiter = Arbiter()
        self.now_ns = START_NS
        self.stopped = set()
        """Sources that have requested motion without a break since the last stop."""
        self.left = {}
        """Owners of those whose connection ended, and when their lease would have."""
        self.sent = {}
        """The same for each lease that there is: the last command of it."""
        self.barred = set()
        """Those that have sent nothing since they were barred."""

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
            lease_s=lease_ms / 1000, linear_m_s=linear_m_s, angular_rad_s=0.0, may_move=True,
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
