# SPDX-License-Identifier: Apache-2.0
"""kinematics_wheels against the textbook in numpy."""

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt import core_oracle
from tests.rt.core_rig import core_config, joint_config

SIDES = st.sampled_from([-1.0, 1.0])
wheel_rows = st.lists(st.tuples(SIDES, st.floats(0.01, 1.0)), min_size=2, max_size=8)


@given(wheel_rows, st.floats(0.05, 3.0), st.floats(-10, 10), st.floats(-10, 10))
def test_wheel_speeds_agree_with_the_velocity_of_the_contact_points(rows, track_m, linear, angular):
    joints = [
        joint_config(
            side,
            wheel_radius_m=radius,
            row={"x": 1.0, "y": 0.0, "lever_m": side * track_m / 2.0},
        )
        for side, radius in rows
    ]
    config = ffi.new("core_config *", core_config(len(rows), joint=joints))
    speeds = ffi.new("double[]", 8)
    lib.kinematics_wheels(config, [linear, angular, 0.0], speeds)
    expected = core_oracle.wheel_speeds(linear, angular, track_m, rows)
    assert list(speeds)[: len(rows)] == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_no_joint_beyond_the_count_is_written():
    config = ffi.new("core_config *", core_config(2))
    speeds = ffi.new("double[]", [7.0] * 8)
    lib.kinematics_wheels(config, [1.0, 0.0, 0.0], speeds)
    assert list(speeds) == [10.0, 10.0, *[7.0] * 6]
