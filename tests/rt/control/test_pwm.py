# SPDX-License-Identifier: Apache-2.0
"""pwm_step: speed to duty."""

import math
from typing import NamedTuple

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st

ANY = st.floats(allow_nan=True, allow_infinity=True)


class Map(NamedTuple):
    dead_band: float = 0.1
    duty_min: float = -1.0
    duty_max: float = 1.0
    slew_per_s: float = math.inf
    full_duty_rad_s: float = 10.0

    def step(self, velocity: float, last: float = 0.0, dt: float = 0.01) -> tuple[float, int]:
        out = lib.pwm_step(ffi.new("pwm_config *", tuple(self)), last, velocity, dt)
        return out.duty, out.reasons


maps = st.builds(
    Map,
    st.floats(0.0, 1.0),
    st.floats(-1.0, 0.0),
    st.floats(0.0, 1.0),
    st.one_of(st.floats(0.1, 100.0), st.just(math.inf)),
    st.floats(0.1, 100.0),
)
DUTY = st.floats(-1.0, 1.0)
SPEED = st.floats(-200.0, 200.0)


def test_the_map_is_a_line_from_the_dead_bands_edge_to_full_duty():
    assert [Map().step(v)[0] for v in (0.0, 1e-9, 5.0, 10.0)] == pytest.approx(
        [0.0, 0.1, 0.55, 1.0]
    )


@given(maps, SPEED)
def test_backward_is_forward_mirrored(pwm, velocity):
    mirrored = pwm._replace(duty_min=-pwm.duty_max, duty_max=-pwm.duty_min)
    assert pwm.step(velocity)[0] == -mirrored.step(-velocity)[0]


@given(maps, DUTY, SPEED)
def test_the_duty_stays_within_its_limits_and_on_the_side_of_its_speed(pwm, last, velocity):
    duty, _ = pwm.step(velocity, last)
    assert pwm.duty_min <= duty <= pwm.duty_max
    assert duty * velocity >= 0.0


@given(maps, SPEED)
def test_the_output_jumps_over_the_dead_band(pwm, velocity):
    duty, reasons = pwm.step(velocity)
    clamped = reasons & lib.REASON_DUTY_CLAMPED
    assert velocity == 0.0 or clamped or abs(duty) >= pwm.dead_band


def test_too_fast_a_set_point_is_clamped_and_reported():
    assert Map(duty_max=0.8).step(100.0) == (0.8, lib.REASON_DUTY_CLAMPED)
    assert Map(duty_min=-0.3).step(-100.0) == (-0.3, lib.REASON_DUTY_CLAMPED)


def test_an_output_that_cannot_reverse_rests_instead():
    duty, reasons = Map(duty_min=0.0).step(-5.0)
    assert (duty, reasons) == (0.0, lib.REASON_DUTY_CLAMPED)
    assert math.copysign(1.0, duty) == 1.0


@given(maps, DUTY, SPEED, st.floats(1e-4, 0.1))
def test_the_slew_binds_away_from_zero_only(pwm, last, velocity, dt):
    duty, reasons = pwm.step(velocity, last, dt)
    free, _ = pwm._replace(slew_per_s=math.inf).step(velocity, last, dt)
    same_side = abs(last) if last * velocity > 0.0 else 0.0
    reach = max(same_side, pwm.dead_band) + pwm.slew_per_s * dt
    assert abs(duty) <= reach
    assert bool(reasons & lib.REASON_DUTY_SLEW) == (duty != free)
    if abs(free) <= same_side:
        assert duty == free, "towards zero is never slowed"


def test_a_reversal_starts_its_slew_at_the_dead_band():
    assert Map(slew_per_s=1.0).step(-10.0, last=0.9) == (
        pytest.approx(-0.11),
        lib.REASON_DUTY_SLEW,
    )


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
def test_a_speed_that_is_no_number_is_no_duty(broken):
    assert Map().step(broken, last=0.5) == (0.0, 0)


@pytest.mark.parametrize("dt", [0.0, -1.0, math.nan])
def test_a_step_without_a_length_is_no_duty(dt):
    assert Map(slew_per_s=1.0).step(5.0, last=0.5, dt=dt) == (0.0, 0)


@given(maps, ANY, ANY, ANY)
def test_no_number_whatsoever_gives_a_duty_outside_of_its_limits(pwm, last, velocity, dt):
    duty, _ = pwm.step(velocity, last, dt)
    assert pwm.duty_min <= duty <= pwm.duty_max
