# SPDX-License-Identifier: Apache-2.0
"""The gyro in the core: its zero, its turn, and a heading that does not jump when the gyro replaces
the wheels or the wheels the gyro."""

import math
import random
from typing import Any

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt.core_rig import TRACK_M, Rig, core_config

GYRO = {
    "used": 1,
    "timeout_s": 0.05,
    "bias_max_rad_s": 0.5,
    "still_variance_rad2_s2": 1e-4,
    "heading_variance_rad2_per_s": 1e-7,
    "turn_variance_rad2_per_rad": 1e-4,
}
SAMPLE_EVERY_TICKS = 5
NOISE_RAD_S = 0.003


class GyroRig(Rig):
    """A base with a gyro that reports the true rate plus offset and noise, 200 times a second."""

    def __init__(self, bias_rad_s: float = 0.03, noise_rad_s: float = NOISE_RAD_S):
        super().__init__(core_config(gyro=GYRO))
        self.bias_rad_s, self.noise_rad_s = bias_rad_s, noise_rad_s
        self.random = random.Random(4)
        self.received = True
        self.slip_left = 0.0
        """Share of the left wheels' turn that is slip, 0 to 1."""
        self.still = False
        """Whether the base does not turn though its wheels do."""
        self.sign = 1.0
        self.true_heading_rad = 0.0
        self.ticked = 0

    def follow(self, dt_s: float) -> None:
        super().follow(dt_s)
        left, right = self.wheel_rad_s[:2]
        radius_m, track_m = self.config.joint[0].wheel_radius_m, TRACK_M
        rate = (right - left * (1.0 - self.slip_left)) * radius_m / track_m
        rate = 0.0 if self.still else rate
        self.true_heading_rad += rate * dt_s
        self.ticked += 1
        if self.received and self.ticked % SAMPLE_EVERY_TICKS == 0:
            self.say(self.sign * rate + self.bias_rad_s + self.random.gauss(0.0, self.noise_rad_s))

    def say(self, rate_rad_s: float, **changes: Any) -> None:
        sample = {"stamp_ns": self.input.now_ns, "angular_rad_s": [0.0, 0.0, rate_rad_s]}
        self.input.imu = ffi.new("imu_sample *", sample | changes)[0]

    @property
    def imu(self) -> Any:
        return self.shown.imu

    def know_zero(self) -> None:
        self.ticks(2.0)
        assert self.imu.state == lib.GYRO_USED

    def heading_error_rad(self) -> float:
        return abs(math.remainder(self.shown.heading_rad - self.true_heading_rad, 2.0 * math.pi))


def test_without_a_gyro_the_page_shows_none():
    rig = Rig()
    rig.input.imu = {"stamp_ns": 1, "angular_rad_s": [1.0, 1.0, 1.0]}
    rig.moving(0.5, 0.5)
    assert bytes(ffi.buffer(ffi.addressof(rig.shown, "imu"))) == bytes(ffi.sizeof("imu_state"))


def test_the_zero_is_found_while_the_base_stands_and_reported_with_its_uncertainty():
    rig = GyroRig(bias_rad_s=-0.11)
    rig.ticks(1.0)
    assert rig.imu.state == lib.GYRO_UNBIASED
    assert math.isnan(rig.imu.bias_rad_s)
    rig.know_zero()
    error_rad_s = math.sqrt(rig.imu.bias_variance_rad2_s2)
    assert 0.0 < error_rad_s < 1e-3
    assert abs(rig.imu.bias_rad_s + 0.11) < 4.0 * error_rad_s
    assert math.sqrt(rig.imu.rate_variance_rad2_s2) == pytest.approx(NOISE_RAD_S, rel=0.3)
    assert abs(rig.imu.angular_rad_s[2]) < 5.0 * NOISE_RAD_S


def test_at_rest_the_heading_is_held_to_the_last_bit_and_nothing_counts_as_turned():
    rig = GyroRig()
    rig.know_zero()
    turned_rad, heading_rad = rig.shown.turned_rad, rig.shown.heading_rad
    rig.ticks(10.0)
    assert rig.imu.still == 1
    assert (rig.shown.turned_rad, rig.shown.heading_rad) == (turned_rad, heading_rad)


def test_the_zero_follows_a_sensor_that_warms_up():
    rig = GyroRig()
    rig.know_zero()
    for _ in range(30):
        rig.bias_rad_s += 0.0005
        rig.ticks(1.0)
    assert rig.imu.bias_rad_s == pytest.approx(rig.bias_rad_s, abs=0.005)


def drive_and_slip(rig: GyroRig) -> None:
    rig.ticks(2.0)
    rig.moving(0.5, 0.3)
    rig.slip_left = 0.4
    rig.ticks(4.0)
    rig.slip_left = 0.0
    rig.ticks(2.0)


def test_when_one_side_slips_the_heading_stays_right_with_the_gyro_and_drifts_without():
    with_gyro, without = GyroRig(), GyroRig()
    without.received = False
    drive_and_slip(with_gyro)
    drive_and_slip(without)
    assert with_gyro.imu.heading_by_gyro == 1
    assert with_gyro.heading_error_rad() < 0.02
    assert without.heading_error_rad() > 0.5


def test_the_heading_does_not_jump_when_wheels_replace_the_gyro_and_back():
    rig = GyroRig(noise_rad_s=0.0)
    rig.know_zero()
    rig.moving(0.3, 0.5)
    seen = set()
    for second in range(12):
        rig.received = second % 3 != 1
        for _ in range(500):
            before_rad = rig.shown.heading_rad
            rig.tick()
            step_rad = math.remainder(rig.shown.heading_rad - before_rad, 2.0 * math.pi)
            assert abs(step_rad - 0.5 * 0.001) < 1e-3  # about two counts of an encoder
            seen.add((rig.imu.state, rig.imu.heading_by_gyro))
    assert seen == {(lib.GYRO_USED, 1), (lib.GYRO_STALE, 0), (lib.GYRO_USED, 0)}
    assert rig.heading_error_rad() < 0.01


def test_a_gyro_mounted_upside_down_is_dropped_and_the_wheels_give_the_heading():
    rig = GyroRig()
    rig.sign = -1.0
    rig.know_zero()
    rig.moving(0.2, 0.8)
    rig.ticks(4.0)
    assert (rig.imu.state, rig.imu.heading_by_gyro) == (lib.GYRO_REVERSED, 0)
    rig.sign = 1.0
    rig.drive(0.2, -0.8)
    assert rig.ticks(4.0).imu.state == lib.GYRO_REVERSED
    before_rad, true_rad = rig.shown.heading_rad, rig.true_heading_rad
    shown = rig.ticks(1.0)
    turned_rad = math.remainder(shown.heading_rad - before_rad, 2.0 * math.pi)
    assert turned_rad == pytest.approx(rig.true_heading_rad - true_rad, abs=0.01)


def test_slipping_wheels_do_not_make_the_core_drop_the_gyro():
    rig = GyroRig()
    rig.know_zero()
    rig.moving(0.2, 0.8)
    rig.still = True
    shown = rig.ticks(20.0)
    assert (shown.imu.state, shown.imu.heading_by_gyro) == (lib.GYRO_USED, 1)


NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


@given(
    st.lists(st.tuples(NUMBERS, st.integers(-(2**63), 2**63 - 1), st.integers(0, 1)), max_size=40)
)
def test_for_any_sensor_input_the_pose_stays_finite_and_its_covariance_positive(reports):
    rig = GyroRig()
    rig.moving(0.4, 0.4)
    rig.received = False
    for rate_rad_s, stamp_ns, saturated in reports:
        for stamp in (stamp_ns, rig.input.now_ns):
            rig.say(rate_rad_s, stamp_ns=stamp, saturated=saturated)
            shown = rig.tick()
            assert math.isfinite(shown.x_m + shown.y_m + shown.heading_rad + shown.turned_rad)
            assert all(shown.pose_covariance[i] > 0.0 for i in (0, 3, 5))
            assert shown.faults == 0
