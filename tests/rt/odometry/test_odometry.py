# SPDX-License-Identifier: Apache-2.0
"""The pose from counters, compared with the textbook: wraps, arcs, covariance; and counters that
are late or wrong."""

import math
import random
from typing import Any

import numpy as np
import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt import core_oracle
from tests.rt.core_rig import RAD_PER_COUNT, RADIUS_M, TRACK_M, core_config, joint_config

STEP_NS = 10_000_000
STEP_S = 0.01
LOOK_NS = 50_000_000  # SPREAD_EVERY_NS in csrc/core/core.h
LEFT, RIGHT = 0, 1


class Base:
    """An odometry_state with its feedback; the test sets counts and time."""

    def __init__(self, step_ns: int = STEP_NS, **changes: Any) -> None:
        rows = [joint_config(side, **changes) for side in (-1.0, 1.0)]
        self.config = ffi.new("core_config *", core_config(joint=rows))
        self.state = ffi.new("odometry_state *")
        lib.odometry_init(self.state, self.config)
        self.feedback = ffi.new("joint_feedback[8]")
        self.stale = ffi.new("uint32_t[8]")
        self.setpoint = ffi.new("joint_setpoint[8]")
        self.now_ns = 1_000_000_000
        self.step_ns = step_ns
        for j in (LEFT, RIGHT):
            self.feedback[j].velocity_rad_s = math.nan
            # far from zero, where no restart is near: these wheels have no inertia
            self.feedback[j].count = 1 << 30

    def take(self) -> None:
        lib.odometry_step(self.state, self.config, self.feedback, self.stale, self.setpoint)

    def step(self, left: int, right: int) -> None:
        """Advance time; each joint's counter advances by the given number and is reported."""
        self.now_ns += self.step_ns
        for j, count in ((LEFT, left), (RIGHT, right)):
            bits = self.config.joint[j].counter_bits or 64
            self.feedback[j].count = (self.feedback[j].count + count) % (1 << bits)
            self.feedback[j].stamp_ns = self.now_ns
        self.take()

    def covariance(self) -> np.ndarray:
        xx, xy, xh, yy, yh, hh = self.state.pose_covariance
        return np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]])


@given(
    st.sampled_from([8, 16, 24, 32, 64]),
    st.integers(0, 2**64 - 1),
    st.integers(-(2**63), 2**63 - 1),
)
def test_a_counter_difference_is_right_across_the_wrap_in_both_directions(bits, before, travel):
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


travels = st.lists(
    st.tuples(st.integers(-140, 140), st.integers(-140, 140)), min_size=1, max_size=60
)


@given(travels)
def test_pose_and_covariance_agree_with_the_oracle(rows):
    base = Base(LOOK_NS)
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


@given(st.floats(-math.pi, math.pi))
def test_the_core_s_own_sine_is_as_exact_as_the_library_s(heading):
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


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=4, max_size=4))
def test_the_pose_is_finite_for_any_velocity_and_set_point(numbers):
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
def test_the_pose_is_finite_for_any_stamp_and_count(rows):
    base = Base(counter_bits=64)
    for stamp_ns, count, epoch in rows:
        feedback = base.feedback[count % 2]
        feedback.stamp_ns, feedback.count, feedback.epoch = stamp_ns, count, epoch
        base.take()
    pose = [base.state.x_m, base.state.y_m, base.state.heading_rad, *base.state.pose_covariance]
    assert all(math.isfinite(value) for value in pose)


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("renewed_every", [2, 5, 10, 20])
@pytest.mark.parametrize("speed_rad_s", [1.0, -7.0, 15.0])
def test_a_counter_updated_more_slowly_than_it_is_read_loses_no_distance(
    renewed_every, speed_rad_s, measured
):
    base = Base()
    per_step = round(speed_rad_s * STEP_S / RAD_PER_COUNT)
    for j in (LEFT, RIGHT):
        base.feedback[j].velocity_rad_s = 0.0 if measured else math.nan
    for _ in range(30):
        base.step(0, 0)
    turned = shown = 0
    for step in range(1, 401):
        turned += per_step
        renewed = turned - shown if step % renewed_every == 0 else 0
        shown += renewed
        for j in (LEFT, RIGHT):
            base.feedback[j].velocity_rad_s = speed_rad_s if measured else math.nan
        base.step(renewed, renewed)
        assert base.state.degraded == 0
        assert not abs(base.state.joint[LEFT].velocity_rad_s) > 1.51 * 15.0
    assert base.state.joint[LEFT].jumps == 0
    assert base.state.x_m == pytest.approx(400 * per_step * RAD_PER_COUNT * RADIUS_M, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_counters_that_are_wrong_all_the_time_never_move_the_wheel_beyond_its_reach(seed):
    base = Base()
    counts = random.Random(seed)
    base.step(0, 0)
    for _ in range(500):
        base.step(counts.randrange(1 << 32), 0)
    assert abs(base.state.joint[LEFT].position_rad) <= 1.5 * 15.0 * 5.0 + 1.0
    assert base.state.joint[LEFT].jumps > 490
