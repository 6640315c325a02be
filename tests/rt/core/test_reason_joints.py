# SPDX-License-Identifier: Apache-2.0
"""A limit that is a joint's names the joint: of duties, and of joints without a base."""

import math

import pytest
from _motord_rt import lib
from tests.rt.core_rig import Rig, core_config, joint_config
from tests.rt.steered_oracle import ROLLS, PositionRig, steers

from motord.realtime.loop import _snapshot


def wheels(*pwm):
    """Alternately left and right; `pwm`: what is other than usual, by joint."""
    joints = []
    for place, changes in enumerate(pwm):
        joint = joint_config(-1.0 if place % 2 == 0 else 1.0)
        joints.append(joint | {"pwm": joint["pwm"] | changes})
    rig = Rig(core_config(len(joints), joint=joints))
    rig.arm()
    return rig


def named(rig):
    return dict(_snapshot(rig.shown).reason_joints)


SLOW = {"slew_per_s": 0.2}


@pytest.mark.parametrize("place", range(4))
def test_the_wheel_whose_slew_rate_bounds_the_ramp_is_named(place):
    rig = wheels(*({"slew_per_s": 5.0} | (SLOW if j == place else {}) for j in range(4)))
    rig.drive(0.5)
    rig.ticks(0.2)
    assert rig.shown.reasons & lib.REASON_DUTY_SLEW
    assert named(rig) == {"duty_slew": (place,)}
    rig.ticks(3.0)
    assert named(rig) == {}


def test_in_a_reversal_it_is_the_wheel_that_has_to_be_eased():
    rig = wheels({}, SLOW)
    rig.drive(0.5)
    rig.ticks(4.0)
    rig.drive(-0.5)
    while rig.shown.setpoint_linear_m_s > 0.0:
        rig.tick()
    assert named(rig) == {"duty_slew": (1,)}


def test_every_wheel_whose_duty_is_clamped_is_named_while_it_is():
    rig = wheels({}, {"duty_max": 0.2}, {"duty_max": 0.2}, {})
    rig.drive(0.5)
    rig.ticks(2.0)
    assert named(rig) == {"duty_clamped": (1, 2)}
    rig.ticks(0.5)
    assert named(rig) == {"duty_clamped": (1, 2)}, "also while nothing changes"
    rig.drive(0.1)
    rig.ticks(2.0)
    assert named(rig) == {}


def test_a_joint_that_takes_positions_has_no_duty_to_be_named():
    own = {"velocity_u_s": 60.0, "acceleration_u_s2": 50.0, "deceleration_u_s2": 50.0}
    belt = ROLLS | {"own": own | {"jerk_u_s3": math.inf}, "pwm": ROLLS["pwm"] | SLOW}
    rig = PositionRig(core_config(2, joint=[steers(1.0), belt], joint_count=2, independent=1))
    rig.arm()
    rig.input.joints.named = 0b11
    rig.input.joints.value_u[0:2] = [0.9, 40.0]
    rig.ticks(0.1)
    assert rig.shown.joint[0].setpoint_rad_s > 0.0
    assert named(rig)["duty_slew"] == (1,)


def test_a_joint_is_named_where_its_position_is_not_known():
    joints = [steers(1.0), steers(1.0, reference=lib.REFERENCE_HOMED)]
    rig = PositionRig(core_config(2, joint=joints, joint_count=2, independent=1))
    rig.input.feedback[1].referenced = 0
    rig.ticks(0.01)
    assert named(rig) == {"position_unknown": (1,)}


def test_joints_without_a_base_are_named_by_the_limit_that_binds_each():
    own = {"velocity_u_s": 60.0, "acceleration_u_s2": 10.0, "deceleration_u_s2": 10.0}
    belt = ROLLS | {"own": own | {"jerk_u_s3": math.inf}}
    joints = [steers(1.0), belt, belt, steers(1.0)]
    rig = PositionRig(core_config(4, joint=joints, joint_count=4, independent=1))
    rig.arm()
    rig.input.joints.named = 0b1111
    rig.input.joints.value_u[0:4] = [0.5, 1.0, 90.0, 4.0]
    rig.tick()
    assert named(rig) == {
        "joint_velocity": (2,),
        "joint_acceleration": (1, 2),
        "joint_position": (3,),
    }
    rig.ticks(8.0)
    assert named(rig) == {"joint_velocity": (2,), "joint_position": (3,)}
