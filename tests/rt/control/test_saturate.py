# SPDX-License-Identifier: Apache-2.0
"""saturate_factor gives one factor for all wheels, by which every wheel keeps its limits."""

import math

import pytest
from _motord_rt import ffi, lib
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.rt.core_rig import Rig, core_config, joint_config

SPEED = st.floats(-1e6, 1e6)
ANY = st.floats(allow_nan=True, allow_infinity=True)


def factor(twists: list[float], limits: list[tuple[float, float]]) -> float:
    joints = ffi.new("joint_config[]", len(limits))
    for joint, (low, high) in zip(joints, limits, strict=True):
        joint.velocity_min_rad_s, joint.velocity_max_rad_s = low, high
    return lib.saturate_factor(ffi.new("double[]", twists), joints, len(twists))


wheels = st.lists(
    st.tuples(SPEED, st.floats(-100.0, -0.001), st.floats(0.001, 100.0)), min_size=1, max_size=8
)


@given(wheels)
def test_after_scaling_every_wheel_is_within_its_limits_to_the_last_bit(rows):
    share = factor([row[0] for row in rows], [row[1:] for row in rows])
    assert 0.0 <= share <= 1.0
    assert all(low <= want * share <= high for want, low, high in rows)


@given(wheels)
def test_the_twist_is_scaled_no_more_than_the_worst_wheel_needs(rows):
    share = factor([row[0] for row in rows], [row[1:] for row in rows])
    if share < 1.0:
        used = [want * share / (high if want > 0 else low) for want, low, high in rows if want]
        assert max(used) == pytest.approx(1.0, abs=1e-12)


@given(st.lists(st.tuples(ANY, ANY, ANY), min_size=1, max_size=8))
def test_the_factor_is_between_zero_and_one_for_any_input(rows):
    assert 0.0 <= factor([row[0] for row in rows], [row[1:] for row in rows]) <= 1.0


# less than 1e-9 rad/s is no command at all
TURN = st.floats(-1.9, 1.9).filter(lambda turn: turn == 0.0 or abs(turn) > 1e-8)


@given(st.floats(0.05, 0.9), TURN, st.floats(1.0, 20.0))
def test_a_saturated_base_settles_on_the_curvature_of_its_command(linear, angular, top_rad_s):
    joints = [
        joint_config(side, velocity_max_rad_s=top_rad_s, velocity_min_rad_s=-top_rad_s)
        for side in (-1.0, 1.0)
    ]
    rig = Rig(core_config(joint=joints))
    rig.arm()
    rig.drive(linear, angular)
    shown = rig.ticks(2.0)
    ratio = shown.setpoint_angular_rad_s / shown.setpoint_linear_m_s
    assert ratio == pytest.approx(angular / linear, rel=1e-9)
    assert max(abs(speed) for speed in rig.speeds) <= top_rad_s
    wanted = (linear + abs(angular) * 0.25) / 0.1
    assert shown.saturation == pytest.approx(min(1.0, top_rad_s / wanted), rel=1e-9)
    saturated = bool(shown.reasons & lib.REASON_WHEEL_SATURATED)
    assert saturated == (shown.saturation < 1.0)


@settings(max_examples=20)
@given(st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-4.0, 4.0)), min_size=2, max_size=4))
@example([(0.88, 0.0), (0.3, 2.0)])
def test_the_reported_twist_is_that_of_the_wheels_also_while_it_ramps(twists):
    joints = [
        joint_config(side, velocity_max_rad_s=9.0, velocity_min_rad_s=-9.0) for side in (-1.0, 1.0)
    ]
    slow = {"velocity_u_s": 1.0, "acceleration_u_s2": 1.0, "deceleration_u_s2": 0.2}
    fast = {"velocity_u_s": 2.0, "acceleration_u_s2": 9.0, "deceleration_u_s2": 9.0}
    limits = {
        "linear": slow | {"jerk_u_s3": math.inf},
        "angular": fast | {"jerk_u_s3": math.inf},
        "lateral": slow | {"jerk_u_s3": math.inf},
    }
    rig = Rig(core_config(joint=joints, limits=limits))
    rig.arm()
    for twist in twists:
        rig.drive(*twist)
        for _ in range(1000):
            shown = rig.tick()
            turn_m_s = shown.setpoint_angular_rad_s * 0.25
            sent = [shown.setpoint_linear_m_s - turn_m_s, shown.setpoint_linear_m_s + turn_m_s]
            assert [speed * 0.1 for speed in rig.speeds] == pytest.approx(sent, abs=1e-12)
            assert max(abs(speed) for speed in rig.speeds) <= 9.0
