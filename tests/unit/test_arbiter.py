# SPDX-License-Identifier: Apache-2.0
"""Leases: who commands, when it lapses, who takes over and who gets it back."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from motord.arbiter import LEASE_MAX_S, LEASE_MIN_S, Arbiter

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


def test_nobody_commands_before_the_first_command():
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


def test_a_release_of_somebody_elses_lease_does_nothing():
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


def test_who_asks_for_motion_before_arming_is_held_after_it():
    arbiter = Arbiter()
    submit(arbiter, 0, may_move=False)
    assert submit(arbiter, 100, may_move=True).twist == (0.0, 0.0)


def test_who_sent_zero_before_arming_drives_at_once():
    arbiter = Arbiter()
    submit(arbiter, 0, linear_m_s=0.0, angular_rad_s=-0.0, may_move=False)
    assert arbiter.wanting(START_NS) is None
    assert submit(arbiter, 100, may_move=True).twist == (0.5, 0.1)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", ["linear_m_s", "angular_rad_s", "lease_s"])
def test_what_is_not_finite_is_refused_and_leaves_the_lease_as_it_was(which, value):
    arbiter = Arbiter()
    before = submit(arbiter, 0)
    with pytest.raises(ValueError):
        submit(arbiter, 10, **{which: value})
    assert arbiter.commander(START_NS + 10 * MS) == before


def test_who_was_held_is_held_on_his_next_connection_until_his_lease_has_lapsed():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    arbiter.disconnect(1)
    assert submit(arbiter, 100, connection=2).held
    arbiter.disconnect(2)
    assert not submit(arbiter, 400, connection=3).held


def test_who_was_held_is_free_on_his_next_connection_when_he_has_sent_zero():
    arbiter = Arbiter()
    submit(arbiter, 0)
    arbiter.hold()
    arbiter.disconnect(1)
    submit(arbiter, 100, connection=2, linear_m_s=0.0, angular_rad_s=0.0)
    assert not submit(arbiter, 150, connection=2).held


@given(lease_s=st.floats())
def test_a_lifetime_out_of_bounds_is_refused(lease_s):
    arbiter = Arbiter()
    if LEASE_MIN_S <= lease_s <= LEASE_MAX_S:
        submit(arbiter, 0, lease_s=lease_s)
    else:
        with pytest.raises(ValueError, match=r"lease_s"):
            submit(arbiter, 0, lease_s=lease_s)


KEYS = {"connection": st.integers(1, 3), "owner": st.sampled_from("ab")}


class Sources(RuleBasedStateMachine):
    """Whatever sources do: the commander is the first of the highest, and nothing outlives its
    lease or passes a stop."""

    def __init__(self):
        super().__init__()
        self.arbiter = Arbiter()
        self.now_ns = START_NS
        self.stopped = set()
        """Sources that have asked for motion without a break since the last stop."""
        self.left = {}
        """Owners of those whose connection ended, and when their lease would have."""

    @rule(**KEYS, priority=st.integers(0, 3), lease_ms=st.integers(20, 5000),
          linear_m_s=st.sampled_from([0.0, -0.0, 0.5, 1e300]))  # fmt: skip
    def command(self, connection, owner, priority, lease_ms, linear_m_s):
        fresh = (connection, owner) in self.fresh()
        left = self.now_ns < self.left.pop(owner, 0)
        lease = self.arbiter.submit(
            self.now_ns, owner=owner, connection=connection, priority=priority,
            lease_s=lease_ms / 1000, linear_m_s=linear_m_s, angular_rad_s=0.0, may_move=True,
        )  # fmt: skip
        if not fresh or linear_m_s == 0.0:
            self.stopped.discard((connection, owner))
        if not fresh and left and linear_m_s != 0.0:
            self.stopped.add((connection, owner))
        if (connection, owner) in self.stopped:
            assert lease.twist == (0.0, 0.0)
        else:
            assert lease.twist == (linear_m_s, 0.0)

    @rule(**KEYS)
    def release(self, connection, owner):
        self.arbiter.release(connection, owner)
        assert (connection, owner) not in self.fresh()

    @rule(connection=st.integers(1, 3))
    def disconnect(self, connection):
        for key, lease in self.fresh().items():
            if key[0] == connection and key in self.stopped:
                self.left[lease.owner] = max(lease.expires_ns, self.left.get(lease.owner, 0))
        self.arbiter.disconnect(connection)
        assert not any(key[0] == connection for key in self.fresh())

    @rule()
    def stop(self):
        self.arbiter.hold()
        self.stopped = {key for key, lease in self.fresh().items() if lease.wants_motion}
        assert all(lease.twist == (0.0, 0.0) for lease in self.arbiter.leases(self.now_ns))

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
                first.priority == lease.priority and first.number <= lease.number
            )


TestSources = Sources.TestCase
