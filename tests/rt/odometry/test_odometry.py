# SPDX-License-Identifier: Apache-2.0
"""Counters to pose: wraps, seeds, jumps, silences, arcs, covariance."""

import math

import numpy as np
import pytest
from _motord_rt import lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt import core_oracle
from tests.rt.core_rig import RAD_PER_COUNT, RADIUS_M, TRACK_M
from tests.rt.odometry.odometry_rig import LEFT, LOOK_NS, RIGHT, STEP_S, Base


@given(
    st.sampled_from([8, 16, 24, 32, 64]),
    st.integers(0, 2**64 - 1),
    st.integers(-(2**63), 2**63 - 1),
)
def test_a_counter_difference_is_right_across_the_wrap_both_ways(bits, before, travel):
    half = 1 << (bits - 1)
    travel = (travel + half) % (1 << bits) - half
    before %= 1 << bits
    now = (before + travel) % (1 << bits)
    assert lib.counter_difference(now, before, bits) == travel


@given(st.integers(0, 2**64 - 1), st.integers(0, 2**64 - 1))
def test_bits_above_the_counters_width_do_not_count(now, before):
    assert lib.counter_difference(now, before, 16) == lib.counter_difference(
        now & 0xFFFF, before & 0xFFFF, 16
    )


@pytest.mark.parametrize("bits", [0, 65, 2**32 - 1])
def test_a_width_that_no_counter_has_moves_nothing(bits):
    assert lib.counter_difference(5, 3, bits) == 0


@pytest.mark.parametrize("bits", [8, 16, 24, 32, 64])
@pytest.mark.parametrize("direction", [-1, 1])
def test_a_drive_across_the_wrap_is_as_long_as_any_other(bits, direction):
    base = Base(counter_bits=bits)
    start = 3 if direction < 0 else (1 << bits) - 3
    base.feedback[LEFT].count = base.feedback[RIGHT].count = start
    base.step(0, 0)
    for _ in range(20):
        base.step(5 * direction, 5 * direction)
    assert base.state.x_m == pytest.approx(direction * 100 * RAD_PER_COUNT * RADIUS_M)
    assert base.state.joint[LEFT].jumps == 0
    assert base.state.degraded == 0


def test_the_first_sample_only_seeds():
    base = Base()
    base.step(1_000_000, 5)
    assert (base.state.x_m, base.state.heading_rad, base.state.distance_m) == (0.0, 0.0, 0.0)
    assert base.state.joint[LEFT].position_rad == 0.0
    assert base.state.joint[LEFT].jumps == 0


def test_the_same_stamp_and_an_older_stamp_are_no_new_sample():
    base = Base()
    base.step(0, 0)
    before_ns = base.now_ns
    for stamp_ns in (before_ns, before_ns - 1, 0, -(2**63)):
        for j in (LEFT, RIGHT):
            base.feedback[j].stamp_ns = stamp_ns
            base.feedback[j].count = 50
        base.take()
    assert base.state.x_m == 0.0
    assert base.state.stamp_ns == before_ns


def test_a_counter_jump_is_refused_counted_and_reported():
    base = Base()
    base.step(0, 0)
    base.step(50, 50)
    before_m = base.state.x_m
    base.step(1_000_000, 50)
    assert base.state.joint[LEFT].jumps == 1
    assert base.state.degraded == 1
    assert base.state.x_m - before_m < 0.1
    base.step(50, 50)
    assert base.state.joint[LEFT].jumps == 1
    assert base.state.degraded == 0


def test_a_robot_at_rest_stays_where_it_is_when_a_counter_jumps():
    base = Base()
    base.step(0, 0)
    base.step(1_000_000, 0)
    assert (base.state.x_m, base.state.y_m, base.state.heading_rad) == (0.0, 0.0, 0.0)
    assert base.state.joint[LEFT].position_rad == 0.0


def test_measured_velocity_stands_in_where_the_counter_cannot_report():
    base = Base()
    base.step(0, 0)
    base.feedback[LEFT].velocity_rad_s = base.feedback[RIGHT].velocity_rad_s = 5.0
    both = round(5.0 * STEP_S / RAD_PER_COUNT)
    base.step(both, both)
    base.feedback[LEFT].epoch = 7
    base.feedback[LEFT].count = 0
    base.step(123, both)
    assert base.state.heading_rad == pytest.approx(0.0, abs=0.01)
    assert base.state.degraded == 1
    assert base.state.joint[LEFT].jumps == 0, "a new epoch is no jump"
    assert base.state.joint[LEFT].position_rad == pytest.approx(2 * 5.0 * STEP_S, abs=0.002)


@pytest.mark.parametrize("velocity", [math.nan, math.inf, 1e300, -1e300])
def test_a_velocity_that_cannot_be_does_not_stand_in(velocity):
    base = Base()
    base.step(0, 0)
    base.feedback[LEFT].velocity_rad_s = velocity
    base.feedback[LEFT].epoch = 7
    base.step(0, 0)
    assert (base.state.x_m, base.state.heading_rad) == (0.0, 0.0)


def test_the_limit_between_travel_and_jump_is_half_again_the_wheels_top_speed():
    base = Base()
    base.step(0, 0)
    most = math.floor(1.5 * 15.0 * STEP_S / RAD_PER_COUNT) + 4
    base.step(most, most)
    assert base.state.joint[LEFT].jumps == 0
    base.step(most + 1, most)
    assert base.state.joint[LEFT].jumps == 1


def test_after_a_silence_in_which_the_counter_may_have_gone_round_it_is_seeded_again():
    base = Base(counter_bits=16)
    base.step(0, 0)
    base.now_ns += 5_000_000_000
    base.step(30_000, 30_000)
    assert base.state.x_m == 0.0
    assert base.state.joint[LEFT].jumps == 0
    assert base.state.degraded == 1


def test_after_a_silence_a_wide_counter_reports_all_that_was_missed():
    base = Base(counter_bits=32)
    base.step(0, 0)
    base.now_ns += 5_000_000_000
    base.step(30_000, 30_000)
    assert base.state.x_m == pytest.approx(30_000 * RAD_PER_COUNT * RADIUS_M)


travels = st.lists(
    st.tuples(st.integers(-140, 140), st.integers(-140, 140)), min_size=1, max_size=60
)


@given(travels)
def test_pose_and_covariance_agree_with_the_oracle(rows):
    base = Base()
    base.step_ns = LOOK_NS
    oracle = core_oracle.Pose(TRACK_M, 1e-4, 1e-3, 1e-6, 1e-6)
    base.step(0, 0)
    for left, right in rows:
        base.step(left, right)
        oracle.roll(left * RAD_PER_COUNT * RADIUS_M, right * RAD_PER_COUNT * RADIUS_M)
        pose = [base.state.x_m, base.state.y_m]
        assert pose == pytest.approx(list(oracle.pose[:2]), rel=1e-12, abs=1e-12)
        turn = math.remainder(base.state.heading_rad - oracle.pose[2], 2.0 * math.pi)
        assert abs(turn) < 1e-12
        assert list(base.state.pose_covariance) == pytest.approx(oracle.six(), rel=1e-9, abs=1e-15)


def test_a_full_circle_ends_where_it_began():
    base = Base()
    base.step(0, 0)
    turn_rad = 2 * 41 * RAD_PER_COUNT * RADIUS_M / TRACK_M
    steps = round(2.0 * math.pi / turn_rad)
    for _ in range(steps):
        base.step(41, 123)
    left_over = steps * turn_rad - 2.0 * math.pi
    assert abs(base.state.heading_rad - left_over) < 1e-9
    assert math.hypot(base.state.x_m, base.state.y_m) < 0.02
    assert base.state.turned_rad == pytest.approx(steps * turn_rad)


@given(st.floats(-math.pi, math.pi))
def test_the_cores_own_sine_is_as_good_as_the_librarys(heading):
    base = Base()
    base.step(0, 0)
    base.state.heading_rad = heading
    base.step(100, 100)
    travel = 100 * RAD_PER_COUNT * RADIUS_M
    assert abs(base.state.x_m - travel * math.cos(heading)) < 1e-16
    assert abs(base.state.y_m - travel * math.sin(heading)) < 1e-16


@given(st.integers(1, 10**6))
def test_a_step_that_turns_a_lot_or_hardly_at_all_is_as_exact(divisor):
    """One wheel stands, the other rolls: the robot turns about the standing wheel."""
    base = Base(counter_bits=64, rad_per_count=1.0 / divisor, velocity_max_rad_s=1e6)
    base.step(0, 0)
    base.step(0, 1000)
    turn = 1000.0 / divisor * RADIUS_M / TRACK_M
    radius = TRACK_M / 2.0
    assert base.state.x_m == pytest.approx(radius * math.sin(turn), rel=1e-9, abs=1e-15)
    expected_y = radius * 2.0 * math.sin(turn / 2.0) ** 2
    assert base.state.y_m == pytest.approx(expected_y, rel=1e-9, abs=1e-15)


@given(travels)
def test_covariance_is_positive_never_below_its_floors_and_distance_never_falls(rows):
    base = Base()
    assert base.state.pose_covariance[0] == 1e-6
    base.step(0, 0)
    before = (0.0, 0.0)
    for left, right in rows:
        base.step(left, right)
        values = np.linalg.eigvalsh(base.covariance())
        assert values.min() > -1e-12 * values.max()
        assert base.covariance().diagonal().min() >= 1e-6
        vv, vw, ww = base.state.twist_covariance
        assert vv >= 1e-5
        assert ww >= 1e-5
        assert vv * ww >= vw * vw
        now = (base.state.distance_m, base.state.turned_rad)
        assert now[0] >= before[0]
        assert now[1] >= before[1]
        before = now


def test_covariance_grows_with_distance_and_with_turn():
    straight, spin = Base(), Base()
    for base in (straight, spin):
        base.step(0, 0)
    sizes = []
    for _ in range(100):
        straight.step(100, 100)
        spin.step(-100, 100)
        sizes.append((straight.covariance()[0, 0], spin.covariance()[2, 2]))
    assert sizes == sorted(sizes)
    assert sizes[-1][0] > 2 * sizes[0][0]
    assert sizes[-1][1] > 2 * sizes[0][1]


def test_measured_twist_is_travel_over_the_stamps_difference():
    base = Base()
    base.step(0, 0)
    base.step(50, 100)
    left, right = (count * RAD_PER_COUNT * RADIUS_M / STEP_S for count in (50, 100))
    assert base.state.linear_m_s == pytest.approx((left + right) / 2)
    assert base.state.angular_rad_s == pytest.approx((right - left) / TRACK_M)
    assert base.state.joint[LEFT].velocity_rad_s == pytest.approx(50 * RAD_PER_COUNT / STEP_S)


def test_velocity_is_unknown_before_it_is_measured():
    base = Base()
    assert math.isnan(base.state.joint[LEFT].velocity_rad_s)
    base.step(5, 5)
    assert math.isnan(base.state.joint[LEFT].velocity_rad_s)
    base.feedback[LEFT].velocity_rad_s = 2.5
    base.step(5, 5)
    assert base.state.joint[LEFT].velocity_rad_s == 2.5


def test_an_arc_waits_until_every_joint_has_brought_a_sample():
    base = Base()
    base.step(0, 0)
    base.step(50, 0, skip=(RIGHT,))
    assert base.state.heading_rad == 0.0
    base.step(0, 50, skip=(LEFT,))
    assert base.state.heading_rad == 0.0
    assert base.state.x_m == pytest.approx(50 * RAD_PER_COUNT * RADIUS_M)


def test_the_sides_of_a_skid_base_are_means_of_their_wheels():
    base = Base(4)
    base.step(0, 0, 0, 0)
    base.step(40, 100, 60, 120)
    expected = (50 + 110) / 2 * RAD_PER_COUNT * RADIUS_M
    assert base.state.distance_m == pytest.approx(expected)


def test_a_stale_wheel_is_left_out_reported_and_not_counted_twice_when_it_is_back():
    base = Base(4)
    base.step(0, 0, 0, 0)
    base.stale[2] = 1
    for _ in range(10):
        base.step(50, 50, 50, 50, skip=(2,))
        assert base.state.degraded == 1
    base.stale[2] = 0
    base.step(50, 50, 550, 50)
    assert base.state.degraded == 0
    assert base.state.x_m == pytest.approx(11 * 50 * RAD_PER_COUNT * RADIUS_M)
    assert base.state.heading_rad == 0.0


def test_a_stale_side_stops_the_integration_and_its_return_reports_what_was_missed():
    base = Base()
    base.step(0, 0)
    base.stale[RIGHT] = 1
    for _ in range(10):
        base.step(50, 50, skip=(RIGHT,))
        assert base.state.degraded == 1
        assert base.state.blind == 1
    assert (base.state.x_m, base.state.heading_rad) == (0.0, 0.0)
    base.stale[RIGHT] = 0
    base.step(50, 550)
    assert base.state.x_m == pytest.approx(550 * RAD_PER_COUNT * RADIUS_M)
    assert base.state.heading_rad == pytest.approx(0.0, abs=1e-12)
    assert (base.state.degraded, base.state.blind) == (0, 0)


def test_a_side_that_is_seeded_later_makes_no_turn_of_the_others_travel():
    base = Base()
    base.stale[RIGHT] = 1
    base.step(0, 0, skip=(RIGHT,))
    base.step(100, 0, skip=(RIGHT,))
    base.stale[RIGHT] = 0
    base.step(100, 0)
    assert (base.state.heading_rad, base.state.x_m) == (0.0, 0.0)
    assert base.state.degraded == 1
    base.step(10, 10)
    assert base.state.x_m == pytest.approx(10 * RAD_PER_COUNT * RADIUS_M)
    assert base.state.degraded == 0


@pytest.mark.parametrize("measured", [True, False])
def test_without_counters_travel_comes_from_velocity_measured_or_requested(measured):
    base = Base(counter_bits=0)
    base.step(0, 0)
    for j in (LEFT, RIGHT):
        base.setpoint[j].velocity_rad_s = -99.0 if measured else 2.0
        base.feedback[j].velocity_rad_s = 2.0 if measured else math.nan
    for _ in range(100):
        base.step(0, 0)
    assert base.state.x_m == pytest.approx(2.0 * RADIUS_M * 1.0)
    assert base.state.degraded == 1
    assert math.isnan(base.state.joint[LEFT].velocity_rad_s) != measured


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=4, max_size=4))
def test_no_velocity_and_no_setpoint_whatsoever_makes_the_pose_other_than_finite(numbers):
    base = Base(counter_bits=0)
    base.step(0, 0)
    for j in (LEFT, RIGHT):
        base.feedback[j].velocity_rad_s = numbers[j]
        base.setpoint[j].velocity_rad_s = numbers[2 + j]
    base.step(0, 0)
    state = base.state
    pose = [state.x_m, state.y_m, state.heading_rad, *state.pose_covariance]
    assert all(math.isfinite(value) for value in pose)
    assert abs(state.x_m) < 0.1


@given(
    st.lists(
        st.tuples(st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**64 - 1), st.integers(0, 2)),
        max_size=20,
    )
)
def test_no_stamp_and_no_count_whatsoever_makes_the_pose_other_than_finite(rows):
    base = Base(counter_bits=64)
    for stamp_ns, count, epoch in rows:
        feedback = base.feedback[count % 2]
        feedback.stamp_ns, feedback.count, feedback.epoch = stamp_ns, count, epoch
        base.take()
    pose = [base.state.x_m, base.state.y_m, base.state.heading_rad, *base.state.pose_covariance]
    assert all(math.isfinite(value) for value in pose)


def test_a_reset_sets_the_pose_to_the_origin_and_leaves_the_wheels():
    base = Base()
    base.step(0, 0)
    for _ in range(50):
        base.step(50, 90)
    before = base.state.joint[LEFT].position_rad, base.state.distance_m
    lib.odometry_reset(base.state, base.config)
    assert (base.state.x_m, base.state.y_m, base.state.heading_rad) == (0.0, 0.0, 0.0)
    assert list(base.state.pose_covariance) == [1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6]
    assert (base.state.joint[LEFT].position_rad, base.state.distance_m) == before
    assert base.state.epoch == 1


def test_a_reset_throws_away_what_was_pending():
    base = Base()
    base.step(0, 0)
    base.step(50, 0, skip=(RIGHT,))
    lib.odometry_reset(base.state, base.config)
    base.step(0, 0)
    assert (base.state.x_m, base.state.heading_rad) == (0.0, 0.0)
