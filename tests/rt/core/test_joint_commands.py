# SPDX-License-Identifier: Apache-2.0
"""Commands for wheels and for joints without a base: Python packs them, the core gets them."""

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
from tests.rt.steered_oracle import ROLLS, steers

from motord.api.commands import joint_datagram, position_datagram
from motord.realtime import loop as rt
from motord_hal.realtime.exchange import now_ns

MS = 1_000_000
START_NS = 5_000_000_000
SPEEDS = st.floats(-50.0, 50.0)
ANY = st.floats(width=64)
PAN, BELT = 0, 1


def base(joints=2, **changes):
    return ffi.new("core_config *", core_config(joints, **changes))


class Source:
    """The only lease of an arbiter."""

    def __init__(self, config):
        self.arbiter = Arbiter(config)
        self.arbiter.grant(START_NS, (1, "teleop"), 100, 300 * MS)
        self.token = self.arbiter.granted[1, "teleop"]["token"]

    def taken(self, raw):
        return self.arbiter.raw(START_NS, bytes(raw)) == 0


class Wheels(Source):
    def say(self, *velocity_rad_s):
        return self.taken(joint_datagram(self.token, 1, START_NS, velocity_rad_s))

    def twist(self):
        out = self.arbiter.command(START_NS)
        return out.linear_m_s, out.angular_rad_s


class Head(Source):
    """A pan joint and a belt."""

    def __init__(self):
        limits = {"acceleration_u_s2": 5.0, "deceleration_u_s2": 5.0, "jerk_u_s3": math.inf}
        joints = [steers(2.0), ROLLS | {"own": limits}]
        super().__init__(base(joint_count=2, joint=joints, independent=1))

    def datagram(self, sequence, *kinds):
        return bytearray(position_datagram(self.token, sequence, START_NS, 2, *kinds))

    def obeyed(self):
        self.arbiter.command(START_NS)
        out = ffi.new("joint_command *")
        lib.arbiter_joints(self.arbiter.c, out)
        return {j: out.value_u[j] for j in range(8) if out.named >> j & 1}


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
def test_the_wheel_speeds_of_a_twist_command_that_twist(joints, radii_m, linear_m_s, angular_rad_s):
    wheels = [
        joint_config(-1.0 if j % 2 == 0 else 1.0, wheel_radius_m=radii_m[j]) for j in range(joints)
    ]
    config = base(joints, joint=wheels)
    made = Wheels(config)
    assert made.say(*wheel_speeds(config, linear_m_s, angular_rad_s))
    assert made.twist() == pytest.approx((linear_m_s, angular_rad_s), abs=1e-9)


@given(left_rad_s=SPEEDS, right_rad_s=SPEEDS)
def test_two_wheels_may_have_any_speeds(left_rad_s, right_rad_s):
    config = base()
    made = Wheels(config)
    assert made.say(left_rad_s, right_rad_s)
    assert wheel_speeds(config, *made.twist()) == pytest.approx([left_rad_s, right_rad_s], abs=1e-9)


@given(st.lists(ANY, min_size=8, max_size=8), st.sampled_from([2, 4, 8]))
def test_any_wheel_command_gives_the_core_finite_numbers(speeds, joints):
    made = Wheels(base(joints))
    made.say(*speeds[:joints])
    assert all(map(math.isfinite, made.twist()))


@given(data=st.binary(min_size=112, max_size=112))
def test_no_datagram_without_the_token_commands_wheels(data):
    made = Wheels(base())
    assert not made.taken(struct.pack("<IHH", 0x434D544D, 1, 3) + data[8:])
    assert made.twist() == (0.0, 0.0)


def test_each_joint_is_commanded_by_velocity_or_position():
    head = Head()
    assert head.taken(head.datagram(1, {BELT: 2.5}, {PAN: -1.0}))
    assert head.obeyed() == {PAN: -1.0, BELT: 2.5}
    assert head.taken(head.datagram(2, {}, {PAN: 0.5}))
    assert head.obeyed() == {PAN: 0.5}
    assert head.taken(joint_datagram(head.token, 3, START_NS, [0.0, 3.0]))
    assert head.obeyed() == {BELT: 3.0}


@given(
    st.lists(ANY, min_size=16, max_size=16),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
)
def test_any_joint_command_gives_the_core_finite_numbers_for_its_own_joints(
    values, velocities, positions
):
    head = Head()
    raw = head.datagram(1, dict(enumerate(values[:8])), dict(enumerate(values[8:])))
    raw[176:184] = velocities.to_bytes(4, "little") + positions.to_bytes(4, "little")
    head.taken(raw)
    obeyed = head.obeyed()
    assert set(obeyed) <= {PAN, BELT}
    assert all(map(math.isfinite, obeyed.values()))


def send(loop, lease, *velocity_rad_s):
    lease._sequence += 1
    loop.send(joint_datagram(lease._grant.token, lease._sequence, now_ns(), velocity_rad_s))


def test_the_loop_turns_the_wheels_as_commanded_and_within_their_limits():
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
