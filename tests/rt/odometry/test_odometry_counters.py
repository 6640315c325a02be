# SPDX-License-Identifier: Apache-2.0
"""Counters that are narrow, late or wrong."""

import math
import random

import pytest
from tests.rt.core_rig import RAD_PER_COUNT, RADIUS_M
from tests.rt.odometry.odometry_rig import LEFT, RIGHT, STEP_NS, STEP_S, Base

DDSM115 = {"counter_bits": 15, "rad_per_count": 2.0 * math.pi / 32768, "top_rad_s": 34.56}
GEAR_30 = {"counter_bits": 16, "rad_per_count": 2.0 * math.pi / (4096 * 30), "top_rad_s": 20.0}


def narrow(counter_bits: int, rad_per_count: float, top_rad_s: float) -> Base:
    return Base(
        counter_bits=counter_bits,
        rad_per_count=rad_per_count,
        velocity_min_rad_s=-top_rad_s,
        velocity_max_rad_s=top_rad_s,
    )


def turn_for(base: Base, seconds: float, speed_rad_s: float, velocity_rad_s: float) -> float:
    """Both wheels turn for so long without a report, and then report; how far each turned."""
    counts = round(speed_rad_s * seconds / base.config.joint[LEFT].rad_per_count)
    base.now_ns += round(seconds * 1e9) - STEP_NS
    for j in (LEFT, RIGHT):
        base.feedback[j].velocity_rad_s = velocity_rad_s
    base.step(counts, counts)
    return counts * float(base.config.joint[LEFT].rad_per_count)


@pytest.mark.parametrize("direction", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("wheel", "speed_rad_s", "silence_s"),
    [(DDSM115, 34.5, 0.110), (GEAR_30, 18.0, 0.200), (DDSM115, 34.5, 0.240)],
)
def test_a_narrow_counter_that_went_round_unseen_is_sent_by_the_measured_velocity(
    wheel, speed_rad_s, silence_s, direction
):
    """As rough as a drive's register of revolutions a minute."""
    base = narrow(**wheel)
    speed_rad_s *= direction
    turn_for(base, STEP_S, 0.0, speed_rad_s)
    turned_rad = turn_for(base, silence_s, speed_rad_s, 0.98 * speed_rad_s)
    assert base.state.joint[LEFT].position_rad == pytest.approx(turned_rad, rel=1e-12)
    assert base.state.x_m == pytest.approx(turned_rad * RADIUS_M, rel=1e-12)
    assert (base.state.degraded, base.state.joint[LEFT].jumps) == (0, 0)


@pytest.mark.parametrize(
    ("wheel", "speed_rad_s", "silence_s"), [(DDSM115, 34.5, 0.110), (GEAR_30, 18.0, 0.200)]
)
def test_a_narrow_counter_without_a_velocity_reports_that_it_may_have_gone_round(
    wheel, speed_rad_s, silence_s
):
    base = narrow(**wheel)
    turn_for(base, STEP_S, 0.0, math.nan)
    turn_for(base, silence_s, speed_rad_s, math.nan)
    assert base.state.degraded == 1
    assert base.state.x_m == 0.0, "a guess would be a turn off, or backward"
    known_rad = turn_for(base, STEP_S, 1.0, math.nan)
    assert base.state.degraded == 0
    assert base.state.x_m == pytest.approx(known_rad * RADIUS_M)


def test_where_the_velocity_changed_too_much_it_stands_in_and_the_odometry_reports_so():
    base = narrow(**DDSM115)
    turn_for(base, STEP_S, 0.0, 0.0)
    turn_for(base, 0.110, 17.0, 34.0)
    assert base.state.degraded == 1
    assert base.state.joint[LEFT].position_rad == pytest.approx(17.0 * 0.110, rel=0.01)


def test_a_narrow_counter_is_sure_as_long_as_the_other_way_round_is_too_far():
    base = narrow(**DDSM115)
    turn_for(base, STEP_S, 0.0, math.nan)
    turned_rad = turn_for(base, 0.080, 20.0, math.nan)
    assert base.state.degraded == 0, (
        "1.6 rad; the other way round it would be 4.7, and the reach 4.1"
    )
    assert base.state.joint[LEFT].position_rad == pytest.approx(turned_rad)


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("renewed_every", [2, 5, 10, 20])
@pytest.mark.parametrize("speed_rad_s", [1.0, -7.0, 15.0])
def test_a_counter_that_is_renewed_more_slowly_than_it_is_read_loses_no_distance(
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


def test_one_wrong_counter_between_right_ones_costs_no_distance():
    base = Base()
    base.step(0, 0)
    base.step(50, 50)
    base.step(1_000_000, 50)
    assert (base.state.degraded, base.state.joint[LEFT].jumps) == (1, 1)
    base.step(-999_900, 50)
    assert base.state.joint[LEFT].jumps == 1, "back where it belongs is no jump"
    positions_rad = [base.state.joint[j].position_rad for j in (LEFT, RIGHT)]
    assert positions_rad == pytest.approx([150 * RAD_PER_COUNT] * 2, rel=1e-12)
    assert base.state.x_m == pytest.approx(150 * RAD_PER_COUNT * RADIUS_M, rel=1e-4)
    assert base.state.heading_rad == pytest.approx(0.0, abs=1e-12)


def test_one_wrong_counter_costs_nothing_either_where_the_velocity_stood_in():
    base = Base()
    base.step(0, 0)
    for j in (LEFT, RIGHT):
        base.feedback[j].velocity_rad_s = 50 * RAD_PER_COUNT / STEP_S * 1.1
    base.step(50, 50)
    base.step(-1_000_000, 50)
    base.step(1_000_100, 50)
    assert base.state.joint[LEFT].position_rad == pytest.approx(150 * RAD_PER_COUNT, rel=1e-12)


@pytest.mark.parametrize("before_steps", [0, 1, 300])
def test_a_counter_that_goes_on_from_another_place_is_refused_once_and_followed_from_there(
    before_steps,
):
    base = Base()
    base.step(0, 0)
    for _ in range(before_steps):
        base.step(0, 0)
    base.step(10_000, 0)
    assert (base.state.joint[LEFT].jumps, base.state.joint[LEFT].position_rad) == (1, 0.0)
    for _ in range(300):
        base.step(20, 20)
        assert base.state.degraded == 0
    assert base.state.joint[LEFT].jumps == 1
    assert base.state.joint[LEFT].position_rad == pytest.approx(300 * 20 * RAD_PER_COUNT)
    assert base.state.heading_rad == pytest.approx(0.0, abs=1e-12)


def test_what_a_counter_at_rest_may_catch_up_is_bounded_by_the_feedback_timeout():
    base = Base()
    base.step(0, 0)
    for _ in range(3000):
        base.step(0, 0)
    most = math.floor(1.5 * 15.0 * (0.25 + STEP_S) / RAD_PER_COUNT) + 4
    base.step(most + 1, 0)
    assert base.state.joint[LEFT].jumps == 1


@pytest.mark.parametrize("seed", range(5))
def test_counters_that_are_wrong_all_the_time_never_move_the_wheel_beyond_its_reach(seed):
    base = Base()
    counts = random.Random(seed)
    base.step(0, 0)
    for _ in range(500):
        base.step(counts.randrange(1 << 32), 0)
    assert abs(base.state.joint[LEFT].position_rad) <= 1.5 * 15.0 * 5.0 + 1.0
    assert base.state.joint[LEFT].jumps > 490
