# SPDX-License-Identifier: Apache-2.0
"""Joints that take positions and do not follow, or whose angle is an estimate, on the core."""

import pytest
from _motord_rt import lib
from tests.rt import steered_oracle as oracle
from tests.rt.core_rig import assert_rest
from tests.rt.steered_oracle import KINDS, SteeredRig


def watched(kind, following_rad, following_s):
    rig = SteeredRig(kind)
    for j in rig.steering:
        rig.state.config.joint[j].position.following_rad = following_rad
        rig.state.config.joint[j].position.following_s = following_s
    return rig


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("after_s", [0.0, 1.0])
def test_a_joint_that_is_stuck_is_a_following_error_that_names_it(kind, after_s):
    rig = watched(kind, 0.05, after_s)
    rig.arm()
    rig.drive(0.5)
    rig.ticks(2.0)
    assert rig.shown.faults == 0
    rig.stuck = {rig.steering[0]}
    rig.drive(0.5, 0.7)
    rig.ticks(0.9)
    assert rig.shown.faults == 0, "not before its time"
    rig.ticks(4.0)
    assert rig.shown.faults == (lib.FAULT_FOLLOWING_ERROR if after_s else 0)
    if after_s:
        assert rig.shown.doubt.joint == rig.steering[0]
        assert rig.shown.doubt.fault == lib.FAULT_FOLLOWING_ERROR
        assert_rest(rig, enabled=0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_joint_that_is_only_slow_follows(kind):
    rig = watched(kind, 0.05, 1.0)
    rig.servo_rad_s = 0.2
    rig.arm()
    for turn in (0.7, -0.7, 0.7):
        rig.drive(0.5, turn)
        rig.ticks(8.0)
        assert rig.shown.faults == 0


@pytest.mark.parametrize("kind", KINDS)
def test_an_angle_that_is_estimated_makes_the_heading_less_certain_than_one_that_is_measured(kind):
    variances = []
    for reference in (lib.REFERENCE_ABSOLUTE, lib.REFERENCE_ESTIMATED):
        joints = [
            joint | {"position": joint["position"] | {"reference": reference}}
            if "position" in joint
            else joint
            for joint in oracle.parts_of(kind)[1]
        ]
        rig = SteeredRig(kind, joint=joints)
        rig.arm()
        rig.drive(0.5)
        rig.ticks(6.0)
        assert rig.shown.distance_m > 1.0
        variances.append(rig.shown.pose_covariance[5] / rig.shown.distance_m)
    assert variances[1] > 2.0 * variances[0]
