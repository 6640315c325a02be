# SPDX-License-Identifier: Apache-2.0
"""Bases whose wheels are steered, on the core: kinematics, limits of every joint, stops, odometry,
and the reaction to a wheel that is not at its angle."""

import math

import numpy as np
import pytest
from _motord_rt import ffi, lib
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.rt import steered_oracle as oracle
from tests.rt.core_rig import ANGULAR, LATERAL, LINEAR, TICK_S, assert_rest
from tests.rt.steered_oracle import CARS, KINDS, RADIUS_M, SteeredRig

SPEED = st.floats(-1.5, 1.5)
TWIST = st.tuples(SPEED, SPEED, SPEED)  # linear, lateral, angular
SLOW = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-1.0, 1.0))


def reachable(kind, twist):
    """Return the twist; for a car, one that moves on a curve that its steering reaches."""
    linear, lateral, angular = twist
    if kind in CARS:
        return linear, 0.0, linear * max(-1.5, min(1.5, angular))
    return linear, lateral, angular


def in_order(twist):
    """Return the twist in the core's order of axes: linear, angular, lateral."""
    return [twist[0], twist[2], twist[1]]


@pytest.mark.parametrize("kind", KINDS)
@given(TWIST)
def test_inverse_after_forward_is_the_identity_on_what_can_be_reached(kind, twist):
    twist = reachable(kind, twist)
    assume(math.hypot(*twist) > 1e-3)
    angles = oracle.pointing(kind, twist)
    rims = oracle.rolling(kind, twist, angles)
    made = ffi.new("twist_inverse *")
    config = ffi.new("core_config *", oracle.config_of(kind))
    lib.kinematics_modules(config, angles, 255, made)
    assert made.determined
    found = [sum(made.inverse[a][j] * rim for j, rim in enumerate(rims)) for a in range(3)]
    assert found == pytest.approx(in_order(twist), abs=1e-9)
    rows = [twist[0], twist[2], twist[1]]
    assert lib.kinematics_residual(config, angles, 255, rims, rows) < 1e-9


@pytest.mark.parametrize("kind", KINDS)
@given(
    st.lists(st.floats(-0.6, 0.6), min_size=8, max_size=8), st.lists(SPEED, min_size=8, max_size=8)
)
def test_the_inverse_is_that_of_least_squares_at_any_angle(kind, angles, rims):
    config, made = ffi.new("core_config *", oracle.config_of(kind)), ffi.new("twist_inverse *")
    steering = {place["steering"] - 1 for place in oracle.parts_of(kind)[0]}
    angles = [angle if j in steering else 0.0 for j, angle in enumerate(angles)]
    lib.kinematics_modules(config, angles, 255, made)
    assert made.determined
    found = [sum(made.inverse[a][j] * rims[j] for j in range(8)) for a in range(3)]
    assert found == pytest.approx(in_order(oracle.twist_of(kind, angles, rims)), abs=1e-7)


def limits_hold(rig, before, angles):
    after = rig.twist
    for limits, old, new in zip((LINEAR, LATERAL, ANGULAR), before, after, strict=True):
        assert abs(new) <= limits["velocity_u_s"] + 1e-12
        rises = abs(new) > abs(old) and old * new >= 0.0
        most = limits["acceleration_u_s2" if rises else "deceleration_u_s2"]
        assert abs(new - old) <= most * TICK_S + 1e-12
    for j, speed_rad_s in enumerate(rig.speeds):
        joint = rig.config.joint[j]
        assert abs(speed_rad_s) <= joint.velocity_max_rad_s
        if j not in rig.steering:
            continue
        assert rig.out.positioned >> j & 1
        own, at_rad, was = joint.position, rig.out.position_rad[j], angles[j]
        assert own.position_min_rad - 1e-9 <= at_rad <= own.position_max_rad + 1e-9
        assert abs(speed_rad_s) <= own.velocity_rad_s + 1e-12
        assert abs(speed_rad_s - was[1]) <= own.acceleration_rad_s2 * TICK_S + 1e-9
        assert abs(at_rad - was[0] - speed_rad_s * TICK_S) <= 1e-9


def steering_of(rig):
    speeds_rad_s = rig.speeds
    return {j: (rig.out.position_rad[j], speeds_rad_s[j]) for j in rig.steering}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8, deadline=None)
@given(st.lists(TWIST, min_size=1, max_size=3), st.sampled_from([8.0, 60.0]))
def test_no_limit_is_exceeded_in_any_tick_and_a_stop_ends_at_rest(kind, twists, fastest_rad_s):
    rig = SteeredRig(kind)
    for j in range(rig.config.joint_count):
        rig.state.config.joint[j].velocity_max_rad_s = fastest_rad_s
        rig.state.config.joint[j].velocity_min_rad_s = -fastest_rad_s
    rig.arm()
    before, angles = rig.twist, steering_of(rig)
    for goal in [*twists, None]:
        if goal is None:
            rig.input.control.stop = 1
        else:
            rig.drive(goal[0], goal[2], goal[1])
        for _ in range(1500):
            rig.tick()
            limits_hold(rig, before, angles)
            before, angles = rig.twist, steering_of(rig)
    assert_rest(rig, enabled=1)
    assert rig.shown.at_rest
    held = rig.angles
    rig.ticks(0.1)
    assert rig.angles == held


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10, deadline=None)
@given(TWIST)
def test_reachable_twists_are_reached_and_the_wheels_roll_as_in_the_textbook(kind, twist):
    twist = reachable(kind, [part / 2.0 for part in twist])
    assume(math.hypot(*twist) > 0.05)
    rig = SteeredRig(kind)
    rig.arm()
    rig.drive(twist[0], twist[2], twist[1])
    rig.ticks(6.0)
    assert list(rig.twist) == pytest.approx(list(twist), abs=1e-8)
    assert rig.shown.reasons == 0
    rims = oracle.rolling(kind, twist, rig.angles)
    assert [speed * RADIUS_M for j, speed in enumerate(rig.speeds) if j not in rig.steering] == (
        pytest.approx([rim for j, rim in enumerate(rims) if j not in rig.steering], abs=1e-5)
    )
    measured = oracle.twist_of(kind, rig.angles, rims)
    assert list(measured) == pytest.approx(list(twist), abs=1e-5)


@pytest.mark.parametrize("kind", CARS)
@settings(max_examples=10, deadline=None)
@given(st.floats(-1.4, 1.4), st.floats(0.2, 3.0), st.floats(4.0, 30.0))
def test_saturation_keeps_the_curve_also_while_it_speeds_up_and_stops(
    kind, curvature_per_m, speed_m_s, fastest_rad_s
):
    rig = SteeredRig(kind)
    for j in range(rig.config.joint_count):
        rig.state.config.joint[j].velocity_max_rad_s = fastest_rad_s
        rig.state.config.joint[j].velocity_min_rad_s = -fastest_rad_s
    rig.arm()
    rig.drive(speed_m_s, speed_m_s * curvature_per_m)
    for tick in range(5000):
        if tick == 3500:
            rig.input.control.stop = 1
        rig.tick()
        linear, _, angular = rig.twist
        assert angular == pytest.approx(linear * curvature_per_m, abs=1e-9)
        if tick == 3499:
            assert linear > 0.1
            limited = linear < speed_m_s * (1.0 - 1e-9)
            why = lib.REASON_LINEAR_VELOCITY | lib.REASON_ANGULAR_VELOCITY
            named = bool(rig.shown.reasons & (why | lib.REASON_WHEEL_SATURATED))
            # exactly at the limit, rounding decides
            assert named == limited or linear == pytest.approx(speed_m_s, rel=1e-9)
    assert_rest(rig)


@pytest.mark.parametrize("kind", KINDS)
def test_a_wheel_that_is_stuck_brings_the_base_to_rest_within_its_limits(kind):
    rig = SteeredRig(kind)
    rig.arm()
    rig.drive(0.5)
    rig.ticks(2.0)
    rig.stuck = {rig.steering[0]}
    rig.drive(0.5, 0.7)
    before = rig.twist
    for _ in range(4000):
        rig.tick()
        for old, new, most in zip(before, rig.twist, (1.5, 1.2, 4.0), strict=True):
            assert abs(new - old) <= most * TICK_S + 1e-12
        before = rig.twist
    assert list(rig.twist) == [0.0] * 3
    assert rig.shown.reasons == lib.REASON_STEERING
    rig.stuck = set()
    rig.ticks(3.0)
    assert list(rig.twist) == [0.5, 0.0, 0.7]


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=20, deadline=None)
@given(SLOW, st.integers(2, 6))
def test_integration_does_not_depend_on_how_time_is_split(kind, twist, parts):
    twist = reachable(kind, twist)
    assume(math.hypot(*twist) > 1e-2)
    whole, split = Odometry(kind, twist), Odometry(kind, twist)
    counts = np.rint(np.array(whole.rims) * 0.02 / (RADIUS_M * oracle.COUNT_RAD))
    for _ in range(parts):
        split.step(counts)
    whole.step(counts * parts, parts)
    for name in ("x_m", "y_m", "heading_rad", "distance_m"):
        found = getattr(split.state, name), getattr(whole.state, name)
        assert found[0] == pytest.approx(found[1], abs=1e-9)
    # the travel over a time: the second sample has one
    assert split.state.linear_m_s == pytest.approx(twist[0], abs=1e-4)
    assert split.state.angular_rad_s == pytest.approx(twist[2], abs=1e-3)


class Odometry:
    """The bare odometry of a base whose wheels point as the twist requires."""

    def __init__(self, kind, twist):
        self.config = ffi.new("core_config *", oracle.config_of(kind))
        self.state = ffi.new("odometry_state *")
        lib.odometry_init(self.state, self.config)
        self.feedback = ffi.new("joint_feedback[8]")
        self.stale, self.setpoint = ffi.new("uint32_t[8]"), ffi.new("joint_setpoint[8]")
        self.angles = oracle.pointing(kind, twist)
        self.rims = oracle.rolling(kind, twist, self.angles)
        self.now_ns = 1_000_000_000
        counts = [round(angle / oracle.COUNT_RAD) for angle in self.angles]
        self.step(counts)

    def step(self, counts, parts=1):
        self.now_ns += 20_000_000 * parts
        for j, count in enumerate(counts):
            self.feedback[j].count = (self.feedback[j].count + int(count)) % (1 << 64)
            self.feedback[j].stamp_ns = self.now_ns
            self.feedback[j].velocity_rad_s = math.nan
        lib.odometry_step(self.state, self.config, self.feedback, self.stale, self.setpoint)


def test_a_module_that_was_never_seen_leaves_the_odometry_to_the_others():
    base = Odometry("swerve4", (0.3, 0.1, 0.2))
    lib.odometry_init(base.state, base.config)
    base.stale[0] = base.stale[1] = 1
    for joint in (0, 1):
        base.feedback[joint].stamp_ns = 0
    counts = np.rint(np.array(base.rims) * 0.02 / (RADIUS_M * oracle.COUNT_RAD))
    for _ in range(5):
        for j in range(2, 8):
            base.feedback[j].count = (base.feedback[j].count + int(counts[j])) % (1 << 64)
            base.feedback[j].stamp_ns = base.now_ns = base.now_ns + 2_500_000
        lib.odometry_step(base.state, base.config, base.feedback, base.stale, base.setpoint)
    assert (base.state.blind, base.state.degraded) == (0, 1)
    assert base.state.distance_m > 0.01
    assert math.isfinite(base.state.spread.slip_m_s)
