# SPDX-License-Identifier: Apache-2.0
"""The mailboxes, through the lines' interface: the newest value replaces the others, and nothing is
lost or mixed up."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.realtime.exchange import (
    JOINTS_MAX,
    LINES_MAX,
    Exchange,
    JointSetpoint,
    Setpoints,
    now_ns,
)

any_float = st.floats(allow_nan=True, allow_infinity=True)
stamps = st.integers(min_value=-(2**63), max_value=2**63 - 1)
joint_setpoints = st.builds(JointSetpoint, any_float, any_float)
setpoint_sets = st.builds(
    Setpoints,
    stamp_ns=stamps,
    tick=st.integers(0, 2**64 - 1),
    enabled=st.booleans(),
    joints=st.lists(joint_setpoints, max_size=JOINTS_MAX).map(tuple),
)


def bits(value: float) -> bytes:
    return b"nan" if math.isnan(value) else struct.pack("d", value)


def same(one: Setpoints, other: Setpoints) -> bool:
    def key(s: Setpoints) -> tuple:
        joints = [(bits(j.velocity_rad_s), bits(j.duty)) for j in s.joints]
        return s.stamp_ns, s.tick, s.enabled, joints

    return key(one) == key(other)


def put(exchange: Exchange, joint: int, count: int) -> None:
    exchange.put_feedback(joint, stamp_ns=count, count=count, epoch=0, enabled=None, drive_faults=0)


def test_an_empty_exchange_moves_nothing():
    exchange = Exchange.private()
    for line in range(LINES_MAX):
        assert exchange.take_setpoints(line) == Setpoints(0, 0, enabled=False, joints=())
    assert exchange.take_feedback(0).stamp_ns == 0


@given(st.lists(st.one_of(st.just("take"), setpoint_sets), max_size=30), st.integers(0, 3))
def test_a_take_gives_the_newest_put(steps, line):
    exchange = Exchange.private()
    newest = Setpoints(0, 0, enabled=False, joints=())
    for step in steps:
        if isinstance(step, Setpoints):
            exchange.put_setpoints(line, step)
            newest = step
        else:
            assert same(exchange.take_setpoints(line), newest)
    assert same(exchange.take_setpoints(line), newest)


@given(
    stamp_ns=stamps,
    count=st.integers(-(2**63), 2**64 - 1),
    floats=st.tuples(any_float, any_float, any_float, any_float),
    epoch=st.integers(0, 2**40),
    enabled=st.sampled_from([True, False, None]),
    drive_faults=st.integers(0, 2**32 - 1),
)
def test_feedback_arrives_as_it_was_reported(stamp_ns, count, floats, epoch, enabled, drive_faults):
    exchange = Exchange.private()
    velocity_rad_s, current_a, voltage_v, temperature_c = floats
    exchange.put_feedback(
        JOINTS_MAX - 1,
        stamp_ns=stamp_ns,
        count=count,
        velocity_rad_s=velocity_rad_s,
        current_a=current_a,
        voltage_v=voltage_v,
        temperature_c=temperature_c,
        epoch=epoch,
        enabled=enabled,
        drive_faults=drive_faults,
    )
    got = exchange.take_feedback(JOINTS_MAX - 1)
    assert (got.stamp_ns, got.count) == (stamp_ns, count % 2**64)
    measured = (got.velocity_rad_s, got.current_a, got.voltage_v, got.temperature_c)
    assert [bits(value) for value in measured] == [bits(value) for value in floats]
    assert (got.epoch, got.enabled) == (epoch % 2**32, enabled)
    assert got.drive_faults == drive_faults


def test_values_that_a_drive_does_not_report_are_nan():
    exchange = Exchange.private()
    put(exchange, 0, 1)
    got = exchange.take_feedback(0)
    assert math.isnan(got.velocity_rad_s)
    assert math.isnan(got.current_a)
    assert math.isnan(got.voltage_v)
    assert math.isnan(got.temperature_c)
    assert got.enabled is None


def test_each_joint_and_each_line_has_a_mailbox_of_its_own():
    exchange, other = Exchange.private(), Exchange.private()
    for index in range(JOINTS_MAX):
        put(exchange, index, 100 + index)
    for line in range(LINES_MAX):
        exchange.put_setpoints(line, Setpoints(200 + line, 0, enabled=True, joints=()))
    assert [exchange.take_feedback(i).count for i in range(JOINTS_MAX)] == list(
        range(100, 100 + JOINTS_MAX)
    )
    assert [exchange.take_setpoints(i).stamp_ns for i in range(LINES_MAX)] == list(
        range(200, 200 + LINES_MAX)
    )
    assert other.take_feedback(0).count == 0


def test_a_joint_or_line_number_out_of_range_is_refused():
    exchange = Exchange.private()
    with pytest.raises(IndexError, match="joint 8"):
        put(exchange, JOINTS_MAX, 1)
    with pytest.raises(IndexError, match="joint 8"):
        exchange.take_feedback(JOINTS_MAX)
    with pytest.raises(IndexError, match="line 4"):
        exchange.take_setpoints(LINES_MAX)
    with pytest.raises(IndexError, match="line 4"):
        exchange.put_setpoints(LINES_MAX, Setpoints(0, 0, enabled=False, joints=()))


def test_more_joints_than_there_are_is_refused():
    joints = (JointSetpoint(0.0, 0.0),) * (JOINTS_MAX + 1)
    with pytest.raises(ValueError, match="9 joints"):
        Exchange.private().put_setpoints(0, Setpoints(0, 0, enabled=False, joints=joints))


def test_the_clock_does_not_go_back():
    stamps_ns = [now_ns() for _ in range(1000)]
    assert stamps_ns == sorted(stamps_ns)
    assert stamps_ns[0] > 0
