# SPDX-License-Identifier: Apache-2.0
"""Commands of wheels: by the same lease and the same judge as those of the base."""

import math
import struct

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt.arbiter_rig import Arbiter
from tests.rt.core_rig import core_config, joint_config
from tests.rt.small_base import arm, report_wheels, settings, until
from tests.rt.small_base import core_config as small_config

from motord.api.commands import Refusal, datagram, joint_datagram
from motord.realtime import loop as rt
from motord_hal.realtime.exchange import now_ns

MS = 1_000_000
START_NS = 5_000_000_000
SPEEDS = st.floats(-50.0, 50.0)
ANY = st.floats(width=64)


def base(joints=2, **changes):
    return ffi.new("core_config *", core_config(joints, **changes))


class Wheels:
    """An arbiter whose only lease commands wheels."""

    def __init__(self, config=None):
        self.arbiter = Arbiter(base() if config is None else config)
        self.arbiter.grant(START_NS, (1, "teleop"), 100, 300 * MS)
        self.token = self.arbiter.granted[1, "teleop"]["token"]
        self.sequence = 0

    def say(self, *velocity_rad_s, may_move=True):
        self.sequence += 1
        raw = joint_datagram(self.token, self.sequence, START_NS, velocity_rad_s)
        return self.judged(raw, may_move=may_move)

    def say_twist(self, linear_m_s, angular_rad_s):
        self.sequence += 1
        return self.judged(datagram(self.token, self.sequence, START_NS, linear_m_s, angular_rad_s))

    def judged(self, raw, *, may_move=True):
        code = self.arbiter.raw(START_NS, raw, may_move)
        return None if code == 0 else Refusal(code - 1)

    def twist(self):
        out = self.arbiter.command(START_NS)
        return out.linear_m_s, out.angular_rad_s


def wheel_speeds(config, linear_m_s, angular_rad_s):
    out = ffi.new("double[8]")
    lib.kinematics_wheels(config, [linear_m_s, angular_rad_s, 0.0], out)
    return list(out[0 : config.joint_count])


@given(
    joints=st.sampled_from([2, 4, 6, 8]),
    radii_m=st.lists(st.floats(0.02, 0.5), min_size=8, max_size=8),
    linear_m_s=st.floats(-5.0, 5.0),
    angular_rad_s=st.floats(-10.0, 10.0),
)
def test_what_the_wheels_of_a_twist_do_is_that_twist(joints, radii_m, linear_m_s, angular_rad_s):
    wheels = [
        joint_config(-1.0 if j % 2 == 0 else 1.0, wheel_radius_m=radii_m[j]) for j in range(joints)
    ]
    config = base(joints, joint=wheels)
    made = Wheels(config)
    assert made.say(*wheel_speeds(config, linear_m_s, angular_rad_s)) is None
    assert made.twist() == pytest.approx((linear_m_s, angular_rad_s), abs=1e-9)


@given(left_rad_s=SPEEDS, right_rad_s=SPEEDS)
def test_two_wheels_may_do_whatever_they_like(left_rad_s, right_rad_s):
    config = base()
    made = Wheels(config)
    assert made.say(left_rad_s, right_rad_s) is None
    assert wheel_speeds(config, *made.twist()) == pytest.approx([left_rad_s, right_rad_s], abs=1e-9)


def test_wheels_at_rest_are_a_command_of_exactly_zero():
    made = Wheels(base(4))
    assert made.say(0.0, 0.0, 0.0, -0.0) is None
    assert made.twist() == (0.0, 0.0)


def test_wheels_of_one_side_that_want_apart_are_refused_and_the_lease_commands_zero():
    made = Wheels(base(4))
    assert made.say(2.0, 2.0, 2.0, 2.0) is None
    assert made.say(2.0, 2.0, 2.1, 2.0) is Refusal.JOINTS
    assert made.twist() == (0.0, 0.0)
    assert made.arbiter.c.report.refused[Refusal.JOINTS] == 1


def test_a_wheel_that_nothing_named_does_not_drag_the_others_along():
    made = Wheels(base(4))
    assert made.say(2.0, 0.0, 0.0, 0.0) is Refusal.JOINTS
    assert made.twist() == (0.0, 0.0)


def test_wheels_of_one_side_may_differ_by_their_rounding():
    made = Wheels(base(4))
    assert made.say(2.0, 2.0, 2.005, 2.0) is None
    assert made.twist() == pytest.approx((0.2, 0.0), abs=1e-3)


@pytest.mark.parametrize("speeds", [(1.0,), (1.0, 1.0, 1.0), ()])
def test_another_number_of_wheels_is_refused(speeds):
    made = Wheels()
    assert made.say(*speeds) is Refusal.JOINTS
    assert made.twist() == (0.0, 0.0)


def test_without_a_base_no_wheel_is_commanded():
    made = Wheels(ffi.NULL)
    assert made.say(1.0, 1.0) is Refusal.JOINTS


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1.7e308])
def test_what_is_not_finite_commands_zero(bad):
    for speeds in ((bad, 1.0), (1.0, bad), (-bad, bad)):
        made = Wheels()
        assert made.say(1.0, 1.0) is None
        made.say(*speeds)
        linear_m_s, angular_rad_s = made.twist()
        assert math.isfinite(linear_m_s)
        assert math.isfinite(angular_rad_s)
        if not math.isfinite(bad):
            assert (linear_m_s, angular_rad_s) == (0.0, 0.0)


@given(st.lists(ANY, min_size=8, max_size=8), st.sampled_from([2, 4, 8]))
def test_whatever_comes_the_core_is_sent_numbers(speeds, joints):
    made = Wheels(base(joints))
    made.say(*speeds[:joints])
    assert all(map(math.isfinite, made.twist()))


@given(data=st.binary(min_size=112, max_size=112))
def test_no_datagram_without_the_token_commands_wheels(data):
    made = Wheels()
    assert made.judged(struct.pack("<IHH", 0x434D544D, 1, 3) + data[8:]) is not None
    assert made.twist() == (0.0, 0.0)


@pytest.mark.parametrize("change", [{"kind": 1}, {"kind": 2}, {"kind": 4}, {"cut": 1}, {"cut": 48}])
def test_a_kind_has_its_own_length(change):
    made = Wheels()
    raw = bytearray(joint_datagram(made.token, 1, START_NS, (1.0, 1.0)))
    struct.pack_into("<H", raw, 6, change.get("kind", 3))
    assert made.judged(bytes(raw[: len(raw) - change.get("cut", 0)])) is Refusal.FORM
    assert made.judged(bytes(raw) + b"\0") is Refusal.FORM


def test_the_newest_command_of_an_owner_counts_whatever_its_kind():
    made = Wheels()
    assert made.say_twist(0.5, 0.0) is None
    assert made.say(0.0, 2.0) is None
    assert made.twist() == pytest.approx((0.1, 0.4))
    assert made.say_twist(0.5, 0.0) is None
    assert made.twist() == (0.5, 0.0)


def test_wheels_that_were_asked_for_through_a_stop_are_held_until_zero():
    made = Wheels()
    assert made.say(1.0, 1.0, may_move=False) is None
    assert made.twist() == (0.0, 0.0)
    made.say(math.nan, 0.0)
    assert made.say(1.0, 1.0) is None
    assert made.twist() == (0.0, 0.0)
    assert made.say(0.0, 0.0) is None
    assert made.say(1.0, 1.0) is None
    assert made.twist() == pytest.approx((0.1, 0.0))


def send(loop, lease, *velocity_rad_s):
    lease._sequence += 1
    loop.send(joint_datagram(lease._grant.token, lease._sequence, now_ns(), velocity_rad_s))


def test_the_loop_turns_the_wheels_as_asked_and_within_their_limits():
    with rt.Loop(small_config(), settings()) as loop:
        lease = arm(loop)
        send(loop, lease, 2.0, 4.0)

        def turning(left_rad_s, right_rad_s):
            report_wheels()
            joints = loop.read_state().joints
            speeds = [joint.setpoint_rad_s for joint in joints]
            return speeds == pytest.approx([left_rad_s, right_rad_s], abs=1e-9)

        until(lambda: turning(2.0, 4.0))
        send(loop, lease, 90.0, 90.0)  # 9 m/s, where 1 m/s is the limit
        until(lambda: turning(10.0, 10.0))
        assert "linear_velocity" in loop.read_state().reasons
        send(loop, lease, 0.0, 0.0)
        until(lambda: turning(0.0, 0.0))
