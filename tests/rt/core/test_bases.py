# SPDX-License-Identifier: Apache-2.0
"""Every base without steering on the one core: kinematics, limits, stops, odometry, slip."""

import math

import numpy as np
import pytest
from _motord_rt import ffi, lib
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.long_cases import long_but
from tests.rt import bases_oracle
from tests.rt.bases_oracle import KINDS, RADIUS_M, STRAFING
from tests.rt.core_rig import (
    ANGULAR,
    LATERAL,
    LINEAR,
    TICK_S,
    Rig,
    assert_rest,
    core_config,
    joint_config,
)

SPEED = st.floats(-3.0, 3.0)
TWIST = st.tuples(SPEED, SPEED, SPEED)  # linear, lateral, angular
COUNT_RAD = 2.0 * math.pi / 65536.0


def config_of(kind, **joint):
    rows = bases_oracle.rows_of(kind)
    joints = [
        joint_config(
            0.0,
            row=dict(zip(("x", "y", "lever_m"), map(float, row), strict=True)),
            wheel_radius_m=RADIUS_M,
            rad_per_count=COUNT_RAD,
            **joint,
        )
        for row in rows
    ]
    return core_config(len(rows), joint=joints)


def in_order(twist):
    """Return the twist in the core's order of axes: linear, angular, lateral."""
    linear, lateral, angular = twist
    return [linear, angular, lateral]


def reachable(kind, twist):
    linear, lateral, angular = twist
    return (linear, lateral if kind in STRAFING else 0.0, angular)


@pytest.mark.parametrize("kind", KINDS)
@given(TWIST)
def test_the_wheels_of_a_twist_are_those_of_the_textbook(kind, twist):
    config = ffi.new("core_config *", config_of(kind))
    speeds = ffi.new("double[8]")
    lib.kinematics_wheels(config, in_order(reachable(kind, twist)), speeds)
    expected = bases_oracle.rows_of(kind) @ np.array(reachable(kind, twist)) / RADIUS_M
    assert list(speeds)[: len(expected)] == pytest.approx(list(expected), abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@given(TWIST)
def test_inverse_after_forward_is_the_identity(kind, twist):
    config = ffi.new("core_config *", config_of(kind))
    speeds, back = ffi.new("double[8]"), ffi.new("double[3]")
    lib.kinematics_wheels(config, in_order(reachable(kind, twist)), speeds)
    assert lib.joints_twist(config, speeds, back)
    assert list(back) == pytest.approx(in_order(reachable(kind, twist)), abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@given(st.lists(st.floats(-5.0, 5.0), min_size=8, max_size=8))
def test_the_inverse_is_that_of_least_squares(kind, rims):
    rows = bases_oracle.rows_of(kind)
    config, made = ffi.new("core_config *", config_of(kind)), ffi.new("twist_inverse *")
    lib.kinematics_invert(config, 2 ** len(rows) - 1, made)
    assert made.determined
    found = [sum(made.inverse[axis][j] * rims[j] for j in range(len(rows))) for axis in range(3)]
    expected = in_order(bases_oracle.twist_of(rows, rims[: len(rows)]))
    assert found == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(
    ("kind", "left", "determined"),
    [
        ("mecanum", 0b0111, True), ("mecanum", 0b1110, True), ("mecanum", 0b0011, False),
        ("omni3", 0b011, False), ("omni4", 0b1011, True), ("skid", 0b0011, True),
        ("skid", 0b0101, False), ("differential", 0b01, False), ("omni8", 0b00010101, True),
    ],
)  # fmt: skip
def test_some_wheels_are_enough_to_know_the_motion_and_others_are_not(kind, left, determined):
    made = ffi.new("twist_inverse *")
    lib.kinematics_invert(ffi.new("core_config *", config_of(kind)), left, made)
    assert bool(made.determined) is determined


def twist(shown):
    return np.array(
        [
            shown.setpoint_linear_m_s,
            shown.lateral.setpoint_lateral_m_s,
            shown.setpoint_angular_rad_s,
        ]
    )


def limits_hold(rig, before, after):
    for limits, old, new in zip((LINEAR, LATERAL, ANGULAR), before, after, strict=True):
        assert abs(new) <= max(limits["velocity_u_s"], abs(old)) + 1e-12
        rises = abs(new) > abs(old) and old * new >= 0.0
        most = limits["acceleration_u_s2" if rises else "deceleration_u_s2"]
        assert abs(new - old) <= most * TICK_S + 1e-12
    speeds_rad_s = rig.speeds
    for j, speed in enumerate(speeds_rad_s):
        assert abs(speed) <= rig.config.joint[j].velocity_max_rad_s
    rows = bases_oracle.rows_of(rig.kind)
    for speed, wanted in zip(speeds_rad_s, rows @ after / RADIUS_M, strict=True):
        assert abs(speed - wanted) <= 1e-9


def rig_of(kind, **joint):
    rig = Rig(config_of(kind, **joint))
    rig.kind = kind
    rig.arm()
    return rig


@pytest.mark.parametrize("kind", long_but(("differential", "mecanum"), KINDS))
@settings(max_examples=8, deadline=None)
@given(st.lists(TWIST, min_size=1, max_size=3), st.sampled_from([6.0, 100.0]))
def test_no_limit_is_exceeded_in_any_tick_and_a_stop_ends_at_rest(kind, twists, fastest_rad_s):
    rig = rig_of(kind, velocity_min_rad_s=-fastest_rad_s, velocity_max_rad_s=fastest_rad_s)
    before = twist(rig.shown)
    for goal in [*twists, (0.0, 0.0, 0.0)]:
        rig.drive(goal[0], goal[2], goal[1])
        for _ in range(600):
            after = twist(rig.tick())
            limits_hold(rig, before, after)
            before = after
    rig.input.control.stop = 1
    for _ in range(3000):
        after = twist(rig.tick())
        limits_hold(rig, before, after)
        before = after
    assert_rest(rig)
    assert rig.shown.lateral.setpoint_lateral_m_s == 0.0
    assert rig.shown.at_rest


@pytest.mark.parametrize("kind", STRAFING)
@settings(max_examples=15, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(0.05, 3.0), st.floats(2.0, 30.0))
def test_saturation_keeps_the_direction_of_motion_also_while_it_ramps(
    kind, direction_rad, speed_m_s, fastest_rad_s
):
    rig = rig_of(kind, velocity_min_rad_s=-fastest_rad_s, velocity_max_rad_s=fastest_rad_s)
    along = np.array([math.cos(direction_rad), math.sin(direction_rad)])
    rig.drive(speed_m_s * along[0], 0.0, speed_m_s * along[1])
    for _ in range(2500):
        now = twist(rig.tick())
        assert abs(now[0] * along[1] - now[1] * along[0]) < 1e-9
        assert now[2] == 0.0
    assert np.dot(now[:2], along) > 0.01
    limited = np.hypot(*now[:2]) < speed_m_s * (1.0 - 1e-9)
    why = lib.REASON_LINEAR_VELOCITY | lib.REASON_LATERAL_VELOCITY | lib.REASON_WHEEL_SATURATED
    assert bool(rig.shown.reasons & why) == limited


class Base:
    """The bare odometry of any base, fed with exact counts of what its rims travel."""

    def __init__(self, kind):
        self.rows = bases_oracle.rows_of(kind)
        self.config = ffi.new(
            "core_config *", config_of(kind, counter_bits=64, velocity_max_rad_s=50.0)
        )
        self.state = ffi.new("odometry_state *")
        lib.odometry_init(self.state, self.config)
        self.feedback = ffi.new("joint_feedback[8]")
        self.stale, self.setpoint = ffi.new("uint32_t[8]"), ffi.new("joint_setpoint[8]")
        self.rad = np.zeros(len(self.rows))
        self.now_ns = 1_000_000_000
        # far from zero, where no restart is near: these wheels have no inertia
        self.step([1 << 40] * len(self.rows))

    def step(self, counts, step_ns=20_000_000):
        self.now_ns += step_ns
        for j, count in enumerate(counts):
            if self.stale[j]:
                continue
            self.feedback[j].count = (self.feedback[j].count + int(count)) % (1 << 64)
            self.feedback[j].stamp_ns = self.now_ns
            self.feedback[j].velocity_rad_s = math.nan
        lib.odometry_step(self.state, self.config, self.feedback, self.stale, self.setpoint)
        return self.state

    def counts(self, twist, seconds):
        """Return the counts nearest to the twist, and the twist of exactly these counts."""
        rims_m = self.rows @ np.asarray(twist) * seconds
        counts = np.rint(rims_m / (RADIUS_M * COUNT_RAD))
        return counts, bases_oracle.twist_of(self.rows, counts * RADIUS_M * COUNT_RAD / seconds)


SLOW = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-1.5, 1.5))


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None)
@given(st.lists(SLOW, min_size=1, max_size=8))
def test_the_pose_is_the_exponential_of_each_twist(kind, twists):
    base, pose, path_m = Base(kind), np.zeros(3), 0.0
    for wanted in twists:
        counts, done = base.counts(reachable(kind, wanted), 0.02)
        state = base.step(counts)
        pose = bases_oracle.moved(pose, done, 0.02)
        path_m += math.hypot(done[0], done[1]) * 0.02
        assert [state.x_m, state.y_m] == pytest.approx(list(pose[:2]), abs=1e-12)
        assert abs(math.remainder(state.heading_rad - pose[2], math.tau)) < 1e-12
        assert state.distance_m == pytest.approx(path_m, abs=1e-12)
        measured = [state.linear_m_s, state.lateral_m_s, state.angular_rad_s]
        assert measured == pytest.approx(list(done), abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None)
@given(SLOW, st.integers(2, 8))
def test_integration_does_not_depend_on_how_time_is_split(kind, wanted, parts):
    whole, split = Base(kind), Base(kind)
    counts, _ = whole.counts(reachable(kind, wanted), 0.02)
    for _ in range(parts):
        split.step(counts)
    whole.step(counts * parts, 20_000_000 * parts)
    for name in ("x_m", "y_m", "heading_rad", "distance_m"):
        assert getattr(split.state, name) == pytest.approx(getattr(whole.state, name), abs=1e-12)


@pytest.mark.parametrize("kind", STRAFING)
@settings(deadline=None)
@given(st.lists(SLOW, min_size=1, max_size=20))
def test_the_covariance_stays_positive_semidefinite_and_grows_with_distance_and_turn(kind, twists):
    base, before = Base(kind), 0.0
    for wanted in twists:
        state = base.step(base.counts(wanted, 0.02)[0])
        xx, xy, xh, yy, yh, hh = state.pose_covariance
        values = np.linalg.eigvalsh(np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]))
        assert values.min() >= -1e-15
        assert hh >= before
        before = hh
        vv, vw, ww = state.twist_covariance
        vs, ss, sw = state.lateral_covariance
        twist_values = np.linalg.eigvalsh(np.array([[vv, vs, vw], [vs, ss, sw], [vw, sw, ww]]))
        assert twist_values.min() > 0.0


def test_a_base_with_a_redundant_wheel_continues_without_one_wheel():
    base = Base("mecanum")
    counts, done = base.counts((0.1, 0.15, 0.2), 0.02)
    base.step(counts)
    base.stale[2] = 1
    pose = bases_oracle.moved(np.zeros(3), done, 0.04)
    state = base.step(counts)
    assert (state.blind, state.degraded) == (0, 1)
    assert [state.x_m, state.y_m] == pytest.approx(list(pose[:2]), abs=1e-5)
    base.stale[3] = 1
    assert base.step(counts).blind == 1
