# SPDX-License-Identifier: Apache-2.0
"""Lines that stay behind the rate that the robot file requests are logged, once."""

import pytest

from motord.control.rate_watch import BEHIND_S, LineRate, RateWatch

LONG_NS = round(BEHIND_S * 1e9)


def looked(watch, at_ns, cycle_hz, line="rs485"):
    return watch.look(at_ns, [LineRate(line=line, cycle_hz=cycle_hz, requested_hz=100.0)])


def test_a_line_that_stays_behind_is_reported_once_with_both_rates():
    watch = RateWatch()
    assert looked(watch, 0, 72.0) == []
    assert looked(watch, LONG_NS - 1, 72.0) == []
    (message,) = looked(watch, LONG_NS, 72.0)
    assert "line rs485 reaches 72 of 100 Hz" in message
    assert looked(watch, 2 * LONG_NS, 70.0) == []


def test_a_line_that_reaches_its_rate_again_is_reported_once():
    watch = RateWatch()
    looked(watch, 0, 72.0)
    looked(watch, LONG_NS, 72.0)
    assert looked(watch, LONG_NS + 1, 99.0) == ["line rs485 reaches its 100 Hz again"]
    assert looked(watch, LONG_NS + 2, 99.0) == []


@pytest.mark.parametrize("between_hz", [0.0, 99.0])
def test_a_line_that_was_not_behind_all_the_time_is_not_reported(between_hz):
    watch = RateWatch()
    looked(watch, 0, 72.0)
    looked(watch, LONG_NS // 2, between_hz)
    looked(watch, LONG_NS // 2 + 1, 72.0)
    assert looked(watch, LONG_NS + 1, 72.0) == []


def test_a_line_without_a_rate_is_not_reported():
    watch = RateWatch()
    assert looked(watch, 0, 0.0) == []
    assert looked(watch, 2 * LONG_NS, 0.0) == []


def test_each_line_is_watched_by_itself():
    watch = RateWatch()
    for at_ns in (0, LONG_NS):
        found = looked(watch, at_ns, 99.0, "can") + looked(watch, at_ns, 72.0)
    assert [message.split(" reaches")[0] for message in found] == ["line rs485"]
