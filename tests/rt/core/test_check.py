# SPDX-License-Identifier: Apache-2.0
"""core_config_check and base_limits_check: each bad number is refused by its name."""

import math
from typing import Any

import pytest
from _motord_rt import ffi, lib
from tests.rt.core_rig import core_config

POSITIVE = [math.nan, math.inf, -math.inf, 0.0, -1.0, 5e-324, 1e300]
BAD: dict[str, list[Any]] = {
    "joint_count": [0, 1, 9, 2**32 - 1],
    "command_timeout_s": POSITIVE,
    "feedback_timeout_s": POSITIVE,
    "heartbeat_timeout_s": POSITIVE,
    "rest_velocity_rad_s": POSITIVE,
    "on_timeout": [4, 2**32 - 1],
    "on_fault": [4],
    "on_estop": [4],
    "distance_variance_m2_per_m": POSITIVE,
    "turn_variance_rad2_per_rad": POSITIVE,
    "pose_variance_floor_m2": POSITIVE,
    "heading_variance_floor_rad2": POSITIVE,
    "twist_variance_floor_m2_s2": POSITIVE,
    "twist_variance_floor_rad2_s2": POSITIVE,
    "limits.linear.velocity_u_s": POSITIVE,
    "limits.linear.acceleration_u_s2": POSITIVE,
    "limits.linear.deceleration_u_s2": POSITIVE,
    "limits.linear.jerk_u_s3": [math.nan, 0.0, -1.0],
    "limits.angular.velocity_u_s": POSITIVE,
    "limits.angular.jerk_u_s3": [math.nan, -math.inf],
    "joint[1].row.x": [-2.1, 2.1, math.nan],
    "joint[1].row.y": [-2.1, 2.1, math.nan],
    "joint[1].row.lever_m": [math.inf, math.nan],
    "joint[1].wheel_radius_m": POSITIVE,
    "joint[1].velocity_min_rad_s": [1.0, math.nan, -math.inf],
    "joint[1].velocity_max_rad_s": POSITIVE,
    "joint[1].rad_per_count": [0.0, math.nan, math.inf],
    "joint[1].counter_bits": [1, 13, 48, 65],
    "joint[1].line": [4, 2**32 - 1],
    "joint[1].pwm.dead_band": [-0.1, 1.1, math.nan],
    "joint[1].pwm.duty_min": [-1.1, 0.1, math.nan],
    "joint[1].pwm.duty_max": [1.1, -0.1, math.nan],
    "joint[1].pwm.slew_per_s": [0.0, -1.0, math.nan],
    "joint[1].pwm.full_duty_rad_s": POSITIVE,
    "joint[1].speed_loop.gains.gain_u_s_per_rad": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.gains.integral_u_per_rad": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.gains.derivative_u_s2_per_rad": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.gains.static_u": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.gains.viscous_u_s_per_rad": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.gains.acceleration_u_s2_per_rad": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.filter_s": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.correction_max_u": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.output_min_u": [1.0, math.nan, -math.inf],
    "joint[1].speed_loop.output_max_u": [-1.0, math.nan, math.inf],
    "joint[1].speed_loop.kind": [3],
}


def check(config: Any) -> str | None:
    name = ffi.new("char[]", lib.FIELD_NAME_BYTES)
    found = lib.core_config_check(config, name)
    return None if found == ffi.NULL else ffi.string(found).decode()


def put(config: Any, path: str, value: Any) -> None:
    *parents, last = path.replace("]", "").replace("[", ".").split(".")
    place = config
    for parent in parents:
        place = place[int(parent)] if parent.isdigit() else getattr(place, parent)
    setattr(place, last, value)


def test_a_good_configuration_has_no_bad_field():
    assert check(ffi.new("core_config *", core_config(4))) is None


@pytest.mark.parametrize(("path", "value"), [(p, v) for p, values in BAD.items() for v in values])
def test_each_bad_number_is_named_and_refused_by_init(path, value):
    config = ffi.new("core_config *", core_config())
    put(config, path, value)
    assert check(config) == path
    assert lib.core_init(ffi.new("core_state *"), config) < 0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_base_needs_wheels_on_both_sides(side):
    config = ffi.new("core_config *", core_config())
    config.joint[0].row.lever_m = config.joint[1].row.lever_m = side
    assert check(config) == "joint.row"


def test_a_joint_without_a_counter_needs_no_counts():
    config = ffi.new("core_config *", core_config())
    config.joint[0].counter_bits = 0
    config.joint[0].rad_per_count = 0.0
    assert check(config) is None


def test_infinite_jerk_and_slew_mean_no_limit():
    config = ffi.new("core_config *", core_config())
    config.limits.linear.jerk_u_s3 = config.joint[0].pwm.slew_per_s = math.inf
    assert check(config) is None


def test_limits_are_checked_by_the_same_rules():
    name = ffi.new("char[]", lib.FIELD_NAME_BYTES)
    limits = ffi.new("base_limits *", core_config()["limits"])
    assert lib.base_limits_check(limits, name) == ffi.NULL
    limits.angular.deceleration_u_s2 = math.nan
    assert ffi.string(lib.base_limits_check(limits, name)) == b"angular.deceleration_u_s2"
