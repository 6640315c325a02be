# SPDX-License-Identifier: Apache-2.0
"""The wall time of a measurement: one stamp for one measurement, and stamps that never go back,
except when the clock was set, which is logged."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.base.wall_clock import SET_NS, SLEW_PPM, WallClock

S = 1_000_000_000
BEGIN_NS = 1_790_000_000 * S


class Clocks:
    """Two clocks that a test moves. Between two reads of them a random time passes."""

    def __init__(self, seed=0, delay_max_ns=0):
        self.random = random.Random(seed)
        self.delay_max_ns = delay_max_ns
        self.now_ns, self.offset_ns = 5 * S, BEGIN_NS

    def _pass(self):
        self.now_ns += self.random.randint(0, self.delay_max_ns)

    def monotonic_ns(self):
        self._pass()
        return self.now_ns

    def wall_ns(self):
        self._pass()
        return self.now_ns + self.offset_ns

    def wall_clock(self):
        return WallClock(self.monotonic_ns, self.wall_ns)


def test_a_moment_has_the_same_wall_time_whenever_it_is_asked_for():
    clocks = Clocks(seed=3, delay_max_ns=40_000)
    clock, found = clocks.wall_clock(), set()
    for _ in range(200):
        clocks.now_ns += S // 100
        clock.look()
        found.add(clock.wall_ns(6 * S))
    assert len(found) == 1


@given(seed=st.integers(0, 2**32), delay_max_ns=st.sampled_from((0, 300, 50_000, 5_000_000)))
def test_the_offset_is_known_within_the_time_of_one_look(seed, delay_max_ns):
    clocks = Clocks(seed, delay_max_ns)
    clock = clocks.wall_clock()
    for _ in range(50):
        clocks.now_ns += S // 50
        clock.look()
        assert abs(clock.wall_ns(clocks.now_ns) - clocks.wall_ns()) <= 3 * delay_max_ns + 1


def test_a_clock_that_drifts_is_followed_slowly():
    clocks = Clocks()
    clock = clocks.wall_clock()
    clocks.offset_ns += SET_NS // 2
    clock.look()
    begin_ns = clocks.now_ns
    for after_s in (1, 2, 5):
        expected_ns = begin_ns + after_s * S + BEGIN_NS + after_s * SLEW_PPM * 1000
        assert clock.wall_ns(begin_ns + after_s * S) == expected_ns
    clocks.now_ns += 100 * S
    assert clock.wall_ns(clocks.now_ns) == clocks.wall_ns()


@pytest.mark.parametrize("step_s", [-3600.0, -0.5, 0.5, 3600.0])
def test_a_clock_that_was_set_is_obeyed_at_once_and_logged_once(step_s, caplog):
    clocks = Clocks(seed=1, delay_max_ns=100)
    clock = clocks.wall_clock()
    before_ns = clocks.now_ns
    stamp_before_ns = clock.wall_ns(before_ns)
    clocks.now_ns += S
    clocks.offset_ns += round(step_s * S)
    for _ in range(20):
        clock.look()
    assert abs(clock.wall_ns(clocks.now_ns) - clocks.wall_ns()) < 1000
    assert clock.wall_ns(before_ns) == stamp_before_ns, "a measurement keeps its stamp"
    (record,) = caplog.records
    assert f"{step_s:+.3f} s" in record.getMessage()


@given(
    seed=st.integers(0, 2**32),
    events=st.lists(
        st.tuples(
            st.integers(1_000, 50_000_000),  # time to the next measurement
            st.integers(0, 20_000_000),  # its age when it is published
            st.sampled_from((0, 0, 0, 0, 0, 0, 500, -30_000, 200_000, -3_000_000, -S, S, -900 * S)),
        ),
        min_size=2,
        max_size=120,
    ),
    delay_max_ns=st.sampled_from((0, 200, 30_000)),
)
def test_stamps_of_a_source_grow_except_where_a_set_clock_was_logged(seed, events, delay_max_ns):
    clocks = Clocks(seed, delay_max_ns)
    clock = clocks.wall_clock()
    last_ns = backward = 0
    measured_ns = clocks.now_ns
    for wait_ns, age_ns, moved_ns in events:
        measured_ns = max(clocks.now_ns, measured_ns) + wait_ns
        clocks.now_ns = measured_ns + age_ns
        clocks.offset_ns += moved_ns
        clock.look()
        stamp_ns = clock.wall_ns(measured_ns)
        assert stamp_ns == clock.wall_ns(measured_ns)
        backward += stamp_ns <= last_ns
        assert backward <= clock.sets
        last_ns = stamp_ns
