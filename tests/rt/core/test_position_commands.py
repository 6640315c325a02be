# SPDX-License-Identifier: Apache-2.0
"""Commands of joints without a base: by the same lease and the same judge as those of a base."""

import math

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt.arbiter_rig import Arbiter
from tests.rt.core_rig import core_config
from tests.rt.steered_oracle import ROLLS, steers

from motord.api.commands import Refusal, datagram, joint_datagram, position_datagram

MS = 1_000_000
START_NS = 5_000_000_000
HEAD = ROLLS | {"own": {"acceleration_u_s2": 5.0, "deceleration_u_s2": 5.0, "jerk_u_s3": math.inf}}
PAN, BELT = 0, 1


class Source:
    """The only lease of an arbiter of a pan joint and a belt, or of another robot."""

    def __init__(self, **changes):
        shape = {"joint_count": 2, "joint": [steers(2.0), HEAD], "independent": 1} | changes
        self.arbiter = Arbiter(ffi.new("core_config *", core_config(2, **shape)))
        self.arbiter.grant(START_NS, (1, "head"), 100, 300 * MS)
        self.token = self.arbiter.granted[1, "head"]["token"]
        self.sequence = 0

    def judged(self, made, *, may_move=True):
        self.sequence += 1
        code = self.arbiter.raw(START_NS, made(self.token, self.sequence, START_NS), may_move)
        return None if code == 0 else Refusal(code - 1)

    def say(self, velocity_rad_s=None, position_rad=None, *, joints=2, may_move=True):
        kinds = velocity_rad_s or {}, position_rad or {}
        return self.judged(
            lambda *head: position_datagram(*head, joints, *kinds), may_move=may_move
        )

    def obeyed(self):
        self.arbiter.command(START_NS)
        out = ffi.new("joint_command *")
        lib.arbiter_joints(self.arbiter.c, out)
        return {j: out.value_u[j] for j in range(8) if out.named >> j & 1}


def test_each_joint_is_commanded_by_what_it_takes():
    head = Source()
    assert head.say({BELT: 2.5}, {PAN: -1.0}) is None
    assert head.obeyed() == {PAN: -1.0, BELT: 2.5}
    assert head.say({}, {PAN: 0.5}) is None
    assert head.obeyed() == {PAN: 0.5}


@pytest.mark.parametrize(
    ("velocity_rad_s", "position_rad"),
    [
        ({PAN: 1.0}, {}),
        ({}, {BELT: 1.0}),
        ({2: 1.0}, {}),
        ({}, {7: 1.0}),
        ({BELT: 1.0}, {BELT: 1.0}),
    ],
)
def test_a_foreign_joint_or_the_wrong_kind_of_set_point_is_refused(velocity_rad_s, position_rad):
    head = Source()
    assert head.say({BELT: 2.0}) is None
    assert head.say(velocity_rad_s, position_rad) is Refusal.JOINTS
    assert head.obeyed() == {}


@pytest.mark.parametrize("joints", [0, 1, 3, 8, 2**32 - 1])
def test_another_number_of_joints_is_refused(joints):
    assert Source().say({BELT: 1.0}, joints=joints) is Refusal.JOINTS


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_commands_nothing(bad):
    for kinds in (({BELT: bad}, {PAN: 0.5}), ({BELT: 1.0}, {PAN: bad})):
        head = Source()
        assert head.say(*kinds) is Refusal.NOT_FINITE
        assert head.obeyed() == {}


def test_ten_times_the_range_or_the_speed_is_a_wrong_unit():
    head = Source()
    assert head.say({}, {PAN: 90.0}) is Refusal.OUT_OF_RANGE
    assert head.say({BELT: 700.0}) is Refusal.OUT_OF_RANGE
    assert head.say({}, {PAN: 15.0}) is None


def test_the_layout_without_positions_commands_velocities_and_no_position():
    head = Source()
    assert head.judged(lambda *h: joint_datagram(*h, [0.0, 3.0])) is None
    assert head.obeyed() == {BELT: 3.0}
    assert head.judged(lambda *h: joint_datagram(*h, [0.1, 3.0])) is Refusal.JOINTS
    assert head.obeyed() == {}


def test_a_twist_other_than_zero_is_refused():
    head = Source()
    assert head.say({BELT: 2.0}) is None
    assert head.judged(lambda *h: datagram(*h, 0.1, 0.0)) is Refusal.JOINTS
    assert head.judged(lambda *h: datagram(*h, 0.0, 0.0)) is None
    assert head.obeyed() == {}


def test_a_base_takes_its_wheels_from_the_new_layout_and_no_position():
    wheels = Source(independent=0, joint=core_config()["joint"])
    assert wheels.say({0: 2.0, 1: 2.0}) is None
    out = wheels.arbiter.command(START_NS)
    assert (out.linear_m_s, out.angular_rad_s) == pytest.approx((0.2, 0.0))
    assert wheels.say({0: 2.0, 1: 2.0}, {1: 0.0}) is Refusal.JOINTS
    assert wheels.say({0: 2.0, 1: 2.0, 2: 0.0}) is Refusal.JOINTS


@pytest.mark.parametrize("cut", [1, 8, 72, 112])
def test_another_length_is_no_form(cut):
    raw = Source()
    whole = position_datagram(raw.token, 1, START_NS, 2, {BELT: 1.0}, {})
    assert raw.judged(lambda *_: whole[:-cut]) is Refusal.FORM
    assert raw.judged(lambda *_: whole + bytes(cut)) is Refusal.FORM


def test_a_position_before_arming_is_held_until_nothing_was_requested():
    head = Source()
    assert head.say({}, {PAN: 0.0}, may_move=False) is None
    assert head.say({}, {PAN: 0.5}) is None
    assert head.obeyed() == {}
    assert head.say() is None
    assert head.say({}, {PAN: 0.5}) is None
    assert head.obeyed() == {PAN: 0.5}


@given(
    st.lists(st.floats(width=64), min_size=16, max_size=16),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
)
def test_whatever_comes_the_core_is_sent_numbers_for_its_own_joints(values, velocities, positions):
    head = Source()
    kinds = dict(enumerate(values[:8])), dict(enumerate(values[8:]))
    raw = bytearray(position_datagram(head.token, 1, START_NS, 2, *kinds))
    raw[176:184] = velocities.to_bytes(4, "little") + positions.to_bytes(4, "little")
    head.judged(lambda *_: bytes(raw))
    obeyed = head.obeyed()
    assert set(obeyed) <= {PAN, BELT}
    assert all(map(math.isfinite, obeyed.values()))
