# SPDX-License-Identifier: Apache-2.0
"""pwm_step converts a speed to a duty."""

import math
from typing import NamedTuple

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


@given(maps, ANY, ANY, ANY)
def test_the_duty_is_within_its_limits_for_any_input(pwm, last, velocity, dt):
    duty, _ = pwm.step(velocity, last, dt)
    assert pwm.duty_min <= duty <= pwm.duty_max
