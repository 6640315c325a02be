# SPDX-License-Identifier: Apache-2.0
"""The limit on the rate of a lease's commands, and the measured rate."""

import pytest
from _motord_rt import ffi, lib

from motord.api.commands import RELEASE, Refusal, datagram

MS = 1_000_000
TOKEN = b"T" * 16
MAY_MOVE = True


class Source:
    """One lease on an arbiter of its own: at most 100 Hz, unless stated otherwise."""

    def __init__(self, interval_least_ns=10 * MS):
        self.c = ffi.new("arbiter *")
        lib.arbiter_init(self.c, ffi.NULL, ffi.NULL)
        lease = {
            "token": TOKEN, "number": 1, "priority": 1, "lifetime_ns": 1000 * MS,
            "interval_least_ns": interval_least_ns,
        }  # fmt: skip
        lib.arbiter_grant(self.c, ffi.new("lease_permissions *", {"lease": [lease]}))
        self.sequence = 0

    def send(self, now_ns, linear_m_s, **options):
        self.sequence += 1
        sent = datagram(TOKEN, self.sequence, now_ns, linear_m_s, 0.0, **options)
        return lib.arbiter_submit(self.c, sent, len(sent), now_ns, MAY_MOVE)

    @property
    def lease(self):
        return self.c.report.lease[0]

    @property
    def refused(self):
        return self.c.report.refused[Refusal.RATE]


def every(interval_ns, count, start_ns=MS):
    return [start_ns + number * interval_ns for number in range(count)]


def test_commands_at_the_rate_that_is_allowed_are_all_taken():
    source = Source()
    assert [source.send(now_ns, 0.1) for now_ns in every(10 * MS, 200)] == [0] * 200


def test_a_burst_is_taken_up_to_its_limit():
    source = Source()
    assert [source.send(MS, 0.1) for _ in range(5)] == [0] * 5
    assert source.send(MS, 0.1) == 1 + Refusal.RATE


def test_at_twice_the_allowed_rate_half_are_taken():
    source = Source()
    taken = sum(source.send(now_ns, 0.1) == 0 for now_ns in every(5 * MS, 400))
    assert 200 <= taken <= 205
    assert source.refused == 400 - taken


def test_a_refused_command_leaves_the_previous_one_in_force():
    source = Source()
    for _ in range(6):
        source.send(MS, 0.1)
    expires_ns = source.lease.expires_ns
    assert source.send(2 * MS, 0.9) == 1 + Refusal.RATE
    assert (source.lease.linear_m_s, source.lease.expires_ns) == (0.1, expires_ns)


def test_zero_and_the_end_of_a_lease_are_never_too_early():
    source = Source()
    for _ in range(100):
        source.send(MS, 0.1)
    assert source.send(MS, 0.0) == 0
    assert source.lease.linear_m_s == 0.0
    assert source.send(MS, 0.0, kind=RELEASE) == 0


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_command_that_is_not_finite_commands_zero_even_too_early(value):
    source = Source()
    for _ in range(100):
        source.send(MS, 0.1)
    assert source.send(MS, value) == 1 + Refusal.NOT_FINITE
    assert source.lease.linear_m_s == 0.0


def test_without_a_limit_as_many_are_taken_as_come():
    source = Source(interval_least_ns=0)
    assert all(source.send(MS, 0.1) == 0 for _ in range(1000))


def test_the_rate_is_measured():
    source = Source(interval_least_ns=0)
    source.send(MS, 0.1)
    assert source.lease.interval_ns == 0
    for now_ns in every(20 * MS, 100, 21 * MS):
        source.send(now_ns, 0.1)
    assert source.lease.interval_ns == 20 * MS
    for now_ns in every(5 * MS, 100, 2006 * MS):
        source.send(now_ns, 0.1)
    assert source.lease.interval_ns == pytest.approx(5 * MS, rel=0.01)
