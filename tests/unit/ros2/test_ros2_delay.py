# SPDX-License-Identifier: Apache-2.0
"""The time that a message waited, computed from stamps of its sender's clock."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.bus.commands.delay import SENDERS_MAX, WINDOW_NS, Delays

S = 1_000_000_000
PERIOD_NS = S // 20
OFFSETS = st.integers(min_value=-(2**62), max_value=2**62)


def steady(delays, offset_ns, start_ns, count, sender="a"):
    """Receive `count` messages, 20 a second, each 1 ms in transit; return their waiting times."""
    return [
        delays.waited_s(sender, at_ns + offset_ns - 1_000_000, at_ns)
        for at_ns in range(start_ns, start_ns + count * PERIOD_NS, PERIOD_NS)
    ]


@given(offset_ns=OFFSETS)
def test_a_steady_stream_has_no_delay_by_any_clock_of_its_sender(offset_ns):
    assert set(steady(Delays(), offset_ns, 0, 300)) == {0.0}


@given(offset_ns=OFFSETS, held_s=st.floats(min_value=0.1, max_value=3600.0))
def test_a_message_that_was_held_up_is_as_old_as_its_delay(offset_ns, held_s):
    delays = Delays()
    steady(delays, offset_ns, 0, 20)
    sent_ns = 20 * PERIOD_NS
    held_ns = round(held_s * 1e9)
    found_s = [
        delays.waited_s("a", sent_ns + part + offset_ns, sent_ns + held_ns)
        for part in range(0, min(held_ns, 2 * S), PERIOD_NS)
    ]
    ages_s = [(held_ns - part) / 1e9 for part in range(0, min(held_ns, 2 * S), PERIOD_NS)]
    assert found_s == pytest.approx(ages_s, abs=0.002)


def test_a_clock_that_was_set_back_is_trusted_again_after_two_windows():
    delays = Delays()
    steady(delays, 0, 0, 40)
    back_ns = -10 * S
    now_ns = 40 * PERIOD_NS
    assert steady(delays, back_ns, now_ns, 1) == [10.0]
    count = 2 * WINDOW_NS // PERIOD_NS + 3
    assert steady(delays, back_ns, now_ns, count)[-1] == 0.0


def test_a_clock_that_was_set_forward_is_trusted_at_once():
    delays = Delays()
    steady(delays, 0, 0, 40)
    assert set(steady(delays, 10 * S, 40 * PERIOD_NS, 40)) == {0.0}


def test_each_sender_has_its_own_clock_and_of_many_the_newest_are_known():
    delays = Delays()
    for number in range(10 * SENDERS_MAX):
        assert set(steady(delays, number * S, 0, 2, sender=number)) == {0.0}
    assert len(delays._clocks) == SENDERS_MAX
    newest = 10 * SENDERS_MAX - 1
    assert delays.waited_s(newest, newest * S, 10 * S) == pytest.approx(10.0, abs=0.002)
