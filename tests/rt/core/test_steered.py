# SPDX-License-Identifier: Apache-2.0
"""Bases whose wheels are steered, on the core: kinematics, limits of every joint, stops, odometry,
and what happens where a wheel is not where it has to be."""

import math

import numpy as np
import pytest
from _motord_rt import ffi, lib
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.rt import steered_oracle as oracle
from tests.rt.core_rig import ANGULAR, LATERAL, LINEAR, TICK_S, assert_rest
from tests.rt.steered_oracle import CARS, KINDS, RADIUS_M, SWERVES, SteeredRig

SPEED = st.floats(-1.5, 1.5)
TWIST = st.tuples(SPEED, SPEED, SPEED)  # linear, lateral, angular
SLOW = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-1.0, 1.0))


def reachable(kind, twist):
    """For a car: a curve that its steering reaches."""
    linear, lateral, angular = twist
    if kind in CARS:
        return linear, 0.0, linear * max(-1.5, min(1.5, angular))
    return linear, lateral, angular


def in_order(twist):
    """As the core has the axes: linear, angular, lateral."""
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
def test_what_can_be_reached_is_reached_and_the_wheels_roll_as_in_the_textbook(kind, twist):
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


def test_a_curve_tighter_than_the_steering_allows_becomes_the_tightest_one():
    rig = SteeredRig("bicycle")
    rig.arm()
    rig.drive(0.3, 3.0)
    shown = rig.ticks(3.0)
    tightest = math.tan(0.6) / oracle.WHEELBASE_M
    assert shown.setpoint_angular_rad_s / shown.setpoint_linear_m_s == pytest.approx(tightest)
    assert shown.reasons == lib.REASON_CURVATURE
    assert rig.angles[1] == pytest.approx(0.6, abs=1e-5)


@pytest.mark.parametrize("kind", ["bicycle", "ackermann", "rear-steered"])
def test_a_car_neither_turns_on_the_spot_nor_strafes_and_reports_it(kind):
    rig = SteeredRig(kind)
    rig.arm()
    rig.drive(0.0, 1.0)
    assert rig.ticks(1.0).reasons == lib.REASON_TURN_IMPOSSIBLE
    assert_rest(rig)
    rig.drive(0.0, 0.0, 0.5)
    assert rig.ticks(1.0).reasons == lib.REASON_LATERAL_IMPOSSIBLE
    assert_rest(rig)


def test_a_tricycle_whose_driven_wheel_turns_across_turns_on_the_spot():
    rig = SteeredRig("tricycle")
    rig.arm()
    rig.drive(0.0, 1.0)
    shown = rig.ticks(4.0)
    assert shown.reasons == 0
    assert shown.setpoint_angular_rad_s == 1.0
    assert (shown.x_m, shown.y_m) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert shown.angular_rad_s == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_at_rest_the_wheels_point_first_and_only_then_it_drives(kind):
    rig = SteeredRig(kind)
    rig.arm()
    rig.drive(0.4, 0.6)
    for _ in range(3000):
        before = rig.twist
        rig.tick()
        off = rig.shown.steering.misaligned_rad
        if off > 0.25:
            assert list(rig.twist) == list(before) == [0.0] * 3
            assert rig.shown.reasons & lib.REASON_STEERING
    assert rig.twist[0] == 0.4


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


def test_a_swerve_module_turns_by_less_than_a_quarter_and_rolls_backward_instead():
    rig = SteeredRig("swerve4")
    rig.arm()
    rig.drive(0.4)
    rig.ticks(2.0)
    rig.drive(-0.4, 0.0, 0.05)
    rig.ticks(3.0)
    assert list(rig.twist) == [-0.4, 0.05, 0.0]
    for j in rig.steering:
        assert abs(rig.angles[j]) < 0.2
        assert rig.speeds[j + 1] < 0.0


@pytest.mark.parametrize("kind", ["bicycle", "swerve4"])
@pytest.mark.parametrize("lost", ["homed", "silent"])
def test_a_joint_whose_position_gets_lost_ends_at_rest_and_is_not_armed_again(kind, lost):
    rig = SteeredRig(kind)
    joint = rig.steering[-1]
    rig.state.config.joint[joint].position.reference = lib.REFERENCE_HOMED
    rig.input.feedback[joint].referenced = 1
    rig.arm()
    rig.drive(0.5)
    rig.ticks(1.5)
    if lost == "homed":
        rig.input.feedback[joint].referenced = 0
        shown = rig.tick()
        assert shown.faults == lib.FAULT_POSITION_UNKNOWN
        assert not rig.out.positioned >> joint & 1
    else:
        rig.hold.add("feedback")
        shown = rig.ticks(0.3)
        assert shown.faults == lib.FAULT_FEEDBACK_STALE
        rig.hold.discard("feedback")
        rig.input.feedback[joint].referenced = 0
    rig.drive(0.0)
    shown = rig.ticks(2.0)
    assert_rest(rig, enabled=0)
    assert rig.out.positioned == 0
    assert shown.steering.unknown == 1 << joint
    assert shown.reasons & lib.REASON_POSITION_UNKNOWN
    rig.reset()
    rig.input.control.armed = 0
    rig.tick()
    rig.input.control.armed = 1
    assert rig.tick().armed == 0
    rig.input.feedback[joint].referenced = 1
    rig.reset()
    rig.input.control.armed = 0
    rig.tick()
    rig.input.control.armed = 1
    assert rig.tick().armed == 1


def test_a_joint_that_measures_nothing_gets_time_to_arrive_before_the_base_moves():
    rig = SteeredRig("bicycle")
    own = rig.state.config.joint[1].position
    own.reference = lib.REFERENCE_ESTIMATED
    rig.state.config.joint[1].counter_bits = 0
    rig.arm()
    rig.drive(0.3, 0.3)
    longest_s = (own.position_max_rad - own.position_min_rad) / own.velocity_rad_s
    shown = rig.ticks(longest_s - 0.01)
    assert list(rig.twist) == [0.0] * 3
    assert shown.reasons & lib.REASON_STEERING
    assert rig.out.position_rad[1] == 0.0
    shown = rig.ticks(3.0)
    assert list(rig.twist) == [0.3, 0.0, 0.3]
    assert shown.joint[1].position_rad == pytest.approx(math.atan(oracle.WHEELBASE_M))


def test_a_disarmed_base_gives_no_positions_and_begins_where_its_joints_are():
    rig = SteeredRig("ackermann")
    rig.position_rad[2], rig.position_rad[3] = 0.3, -0.2
    rig.ticks(0.1)
    assert rig.out.positioned == 0
    assert all(math.isnan(rig.shown.steering.setpoint_rad[j]) for j in rig.steering)
    rig.input.control.armed = 1
    rig.tick()
    assert [rig.out.position_rad[j] for j in (2, 3)] == pytest.approx([0.3, -0.2], abs=1e-5)
    rig.ticks(0.5)
    assert [rig.out.position_rad[j] for j in (2, 3)] == pytest.approx([0.3, -0.2], abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_is_rest_and_holds_the_steering(kind, broken):
    rig = SteeredRig(kind)
    rig.arm()
    rig.drive(0.3, 0.2)
    rig.ticks(2.0)
    rig.drive(broken, 0.2)
    rig.ticks(2.0)
    assert_rest(rig)
    assert all(math.isfinite(rig.out.position_rad[j]) for j in rig.steering)
    assert rig.out.positioned == sum(1 << j for j in rig.steering)


@settings(deadline=None)
@given(
    st.floats(-3.0, 3.0), st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=4),
    st.floats(0.1, 20.0), st.floats(0.5, 200.0), st.sampled_from([0.001, 0.002, 0.01]),
)  # fmt: skip
def test_a_profile_keeps_its_limits_and_does_not_pass_its_goal(start, goals, most, slope, dt_s):
    config = ffi.new("position_config *")
    config.velocity_rad_s, config.acceleration_rad_s2 = most, slope
    profile = ffi.new("position_profile *", {"position_rad": start})
    for goal in goals:
        lib.position_step(profile, config, math.nan, dt_s)
        while profile.velocity_rad_s:
            lib.position_step(profile, config, math.nan, dt_s)
        begin = profile.position_rad
        for _ in range(200_000):
            was = profile.position_rad, profile.velocity_rad_s
            lib.position_step(profile, config, goal, dt_s)
            assert abs(profile.velocity_rad_s) <= most
            assert abs(profile.velocity_rad_s - was[1]) <= slope * dt_s * (1.0 + 1e-9)
            at_rad = profile.position_rad
            assert min(begin, goal) - 1e-9 <= at_rad <= max(begin, goal) + 1e-9
            if at_rad == goal and profile.velocity_rad_s == 0.0:
                break
        assert profile.position_rad == goal


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
    assert whole.state.linear_m_s == pytest.approx(twist[0], abs=1e-4)
    assert whole.state.angular_rad_s == pytest.approx(twist[2], abs=1e-3)


class Odometry:
    """The bare odometry of a base whose wheels point as for a twist."""

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


@pytest.mark.parametrize("kind", [*SWERVES, "ackermann"])
def test_wheels_that_work_against_each_other_are_slip(kind):
    clean, slips = (Odometry(kind, (0.3, 0.0, 0.1)) for _ in range(2))
    counts = np.rint(np.array(clean.rims) * 0.02 / (RADIUS_M * oracle.COUNT_RAD))
    against = np.zeros(len(counts))
    against[np.nonzero(counts)[0][0]] = 0.2 * np.abs(counts).max()
    for _ in range(100):
        clean.step(counts)
        slips.step(counts + against)
    assert clean.state.spread.slip_m_s < 1e-4
    assert slips.state.spread.slip_m_s > 0.01
    assert slips.state.pose_covariance[0] > 1.5 * clean.state.pose_covariance[0]


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


BROKEN = {
    "swerve with one module": ("swerve4", {"module_count": 1, "joint_count": 2}),
    "a steering joint twice": ("ackermann", {"module": [(1, "steering", 3)]}),
    "a traction joint that steers": ("ackermann", {"module": [(2, "traction", 3)]}),
    "a steered wheel on the fixed axle": ("bicycle", {"module": [(0, "x_m", 0.0)]}),
    "a fixed wheel off the axle": ("ackermann", {"module": [(2, "x_m", 0.1)]}),
    "nothing drives": ("bicycle", {"module": [(1, "traction", 0)]}),
    "a range of nothing": ("bicycle", {"range": (0.0, 0.0)}),
    "a range beyond its zero": ("bicycle", {"range": (0.1, 0.3)}),
    "a swerve that cannot point sideways": ("swerve3", {"range": (-1.0, 1.0)}),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_geometry_that_cannot_work_is_refused(what):
    kind, change = BROKEN[what]
    config = ffi.new("core_config *", oracle.config_of(kind))
    for name, value in change.items():
        if name == "module":
            for number, key, new in value:
                setattr(config.module[number], key, new)
        elif name == "range":
            for j in range(config.joint_count):
                config.joint[j].position.position_min_rad = value[0]
                config.joint[j].position.position_max_rad = value[1]
        else:
            setattr(config, name, value)
    assert lib.core_init(ffi.new("core_state *"), config) < 0


def test_commands_that_a_car_cannot_obey_are_counted():
    config = ffi.new("core_config *", oracle.config_of("bicycle"))
    assert not lib.kinematics_spins(config)
    for kind in ("tricycle", *SWERVES):
        assert lib.kinematics_spins(ffi.new("core_config *", oracle.config_of(kind)))
