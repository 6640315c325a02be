# SPDX-License-Identifier: Apache-2.0
"""The simulator's physics: rest stays rest, energy has a source, paths are arcs."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motord_hal.sim.plant import SUBSTEP_S, Contact, Encoder, Plant, Wheel, WheelModel

MODEL = WheelModel()
FRICTIONLESS = WheelModel(coulomb_n_m=0.0, viscous_n_m_s_rad=0.0)
SPEEDS = st.floats(-30.0, 30.0)
NOT_FINITE = [math.nan, math.inf, -math.inf]


def base(model=MODEL, track_m=0.5, radius_m=0.1, **options):
    left, right = Wheel(model), Wheel(model)
    contacts = {
        "left": Contact(side="left", wheel_radius_m=radius_m),
        "right": Contact(side="right", wheel_radius_m=radius_m),
    }
    plant = Plant({"left": left, "right": right}, contacts, track_m, **options)
    return plant, left, right


def go_on(wheel, seconds):
    for _ in range(round(seconds / SUBSTEP_S)):
        wheel.substep(SUBSTEP_S)


@pytest.mark.parametrize(
    "hold", [Wheel.coast, Wheel.brake, lambda w: w.turn(0.0), lambda w: w.push(0.0, 15.0)]
)
def test_a_wheel_at_rest_stays_at_rest_to_the_last_bit(hold):
    wheel = Wheel(MODEL)
    hold(wheel)
    go_on(wheel, 2.0)
    assert (wheel.velocity_rad_s, wheel.position_rad, wheel.torque_n_m) == (0.0, 0.0, 0.0)


@settings(deadline=None)
@given(SPEEDS)
def test_a_coasting_wheel_loses_energy_in_every_step_until_it_rests(speed_rad_s):
    wheel = Wheel(MODEL)
    wheel.velocity_rad_s = speed_rad_s
    before = abs(speed_rad_s)
    for _ in range(20_000):
        if wheel.velocity_rad_s == 0.0:
            break
        wheel.substep(SUBSTEP_S)
        assert abs(wheel.velocity_rad_s) < before
        before = abs(wheel.velocity_rad_s)
    assert wheel.velocity_rad_s == 0.0


@settings(deadline=None)
@given(st.lists(SPEEDS, min_size=1, max_size=5))
def test_no_set_point_gets_more_torque_than_the_motor_has(speeds_rad_s):
    wheel = Wheel(MODEL)
    for speed_rad_s in speeds_rad_s:
        wheel.turn(speed_rad_s)
        for _ in range(50):
            before = wheel.velocity_rad_s
            wheel.substep(SUBSTEP_S)
            assert abs(wheel.torque_n_m) <= MODEL.torque_max_n_m
            friction_n_m = MODEL.coulomb_n_m + MODEL.viscous_n_m_s_rad * abs(before) + 1e-9
            change_rad_s = (MODEL.torque_max_n_m + friction_n_m) / MODEL.inertia_kg_m2 * SUBSTEP_S
            assert abs(wheel.velocity_rad_s - before) <= change_rad_s


@settings(deadline=None)
@given(SPEEDS)
def test_the_speed_loop_reaches_its_set_point(speed_rad_s):
    wheel = Wheel(MODEL)
    wheel.turn(speed_rad_s)
    go_on(wheel, 2.0)
    assert wheel.velocity_rad_s == pytest.approx(speed_rad_s, abs=0.02)


@settings(deadline=None)
@given(SPEEDS)
def test_a_quick_stop_ends_at_rest_within_its_ramp(speed_rad_s):
    wheel = Wheel(MODEL)
    wheel.turn(speed_rad_s)
    go_on(wheel, 1.0)
    wheel.brake()
    go_on(wheel, abs(speed_rad_s) / MODEL.deceleration_rad_s2 + 0.3)
    assert wheel.velocity_rad_s == 0.0


@settings(deadline=None)
@given(SPEEDS)
def test_a_set_point_of_zero_ends_at_rest_and_does_not_creep(speed_rad_s):
    wheel = Wheel(MODEL)
    wheel.velocity_rad_s = speed_rad_s
    wheel.turn(0.0)
    go_on(wheel, 1.5)
    stopped_rad = wheel.position_rad
    go_on(wheel, 1.0)
    assert wheel.velocity_rad_s == 0.0
    assert wheel.position_rad == stopped_rad


def test_a_torque_below_static_friction_moves_nothing():
    wheel = Wheel(MODEL)
    wheel.push(0.9 * MODEL.coulomb_n_m / MODEL.torque_max_n_m, 15.0)
    go_on(wheel, 1.0)
    assert wheel.position_rad == 0.0
    wheel.push(1.5 * MODEL.coulomb_n_m / MODEL.torque_max_n_m, 15.0)
    go_on(wheel, 1.0)
    assert wheel.velocity_rad_s > 0.0


@settings(deadline=None)
@given(st.floats(0.1, 1.0), st.floats(5.0, 20.0))
def test_a_duty_turns_the_wheel_along_the_speed_torque_line(duty, full_duty_rad_s):
    wheel = Wheel(MODEL)
    wheel.push(duty, full_duty_rad_s)
    go_on(wheel, 3.0)
    drag_n_m = MODEL.coulomb_n_m + MODEL.viscous_n_m_s_rad * wheel.velocity_rad_s
    line_n_m = MODEL.torque_max_n_m * (duty - wheel.velocity_rad_s / full_duty_rad_s)
    assert line_n_m == pytest.approx(drag_n_m, rel=0.01)


def test_a_torque_turns_the_wheel_faster_and_faster_by_what_friction_leaves():
    wheel = Wheel(MODEL)
    wheel.drive(-1.0)
    go_on(wheel, 0.1)
    left_n_m = 1.0 - MODEL.coulomb_n_m
    assert wheel.velocity_rad_s == pytest.approx(-left_n_m / MODEL.inertia_kg_m2 * 0.1, rel=0.05)
    wheel.drive(2 * MODEL.torque_max_n_m)
    go_on(wheel, 0.001)
    assert wheel.torque_n_m == MODEL.torque_max_n_m


def test_work_warms_the_winding():
    wheel = Wheel(MODEL)
    wheel.push(1.0, 1.0)
    go_on(wheel, 2.0)
    cold_c = Wheel(MODEL).winding_c
    assert wheel.winding_c > cold_c


@pytest.mark.parametrize("bad", NOT_FINITE)
def test_a_value_that_is_not_finite_is_refused(bad):
    plant, wheel, _ = base()
    for ask in (
        lambda: wheel.turn(bad),
        lambda: wheel.push(bad, 15.0),
        lambda: wheel.push(0.5, bad),
        lambda: wheel.drive(bad),
        lambda: plant.step(bad),
        lambda: base(track_m=bad),
    ):
        with pytest.raises(ValueError):
            ask()
    plant.step(0.1)
    assert plant.at_rest


def test_time_does_not_run_backward():
    plant, _, _ = base()
    with pytest.raises(ValueError, match="time step"):
        plant.step(-0.001)


@settings(deadline=None)
@given(SPEEDS, SPEEDS)
def test_constant_wheel_speeds_draw_the_circle_of_the_closed_form(left_rad_s, right_rad_s):
    plant, left, right = base(FRICTIONLESS)
    left.velocity_rad_s, right.velocity_rad_s = left_rad_s, right_rad_s
    plant.step(1.5)
    left_m, right_m = 0.1 * left.position_rad, 0.1 * right.position_rad
    forward_m, turn_rad = (left_m + right_m) / 2, (right_m - left_m) / 0.5
    half = turn_rad / 2
    chord_m = forward_m * (math.sin(half) / half if half else 1.0)
    truth = plant.truth
    assert truth.x_m == pytest.approx(chord_m * math.cos(half), abs=1e-9)
    assert truth.y_m == pytest.approx(chord_m * math.sin(half), abs=1e-9)
    wrapped = math.remainder(truth.heading_rad - turn_rad, 2 * math.pi)
    assert wrapped == pytest.approx(0.0, abs=1e-9)
    assert truth.turned_rad == pytest.approx(abs(turn_rad), abs=1e-9)
    assert truth.distance_m == pytest.approx(abs(forward_m), abs=1e-9)
    assert truth.moved_max_m_s == pytest.approx(0.1 * max(abs(left_rad_s), abs(right_rad_s)))


def test_rest_is_timed_from_the_moment_the_last_wheel_stops():
    plant, left, _ = base()
    plant.step(0.5)
    assert plant.rest_s == pytest.approx(0.5)
    left.turn(3.0)
    plant.step(0.5)
    assert plant.rest_s == 0.0
    left.brake()
    plant.step(1.0)
    assert 0.5 < plant.rest_s < 1.0


def test_a_reset_of_the_truth_keeps_the_turns_of_the_wheels():
    plant, left, right = base()
    left.turn(3.0)
    right.turn(5.0)
    plant.step(1.0)
    turned_rad = right.position_rad
    plant.reset_truth()
    assert (plant.truth.x_m, plant.truth.heading_rad, plant.truth.distance_m) == (0.0, 0.0, 0.0)
    assert right.position_rad == turned_rad > 0


def test_slip_depends_on_its_seed_alone():
    def end(seed):
        plant, left, right = base(slip_variance_m2_per_m=1e-4, seed=seed)
        left.turn(5.0)
        right.turn(5.0)
        plant.step(1.0)
        return plant.truth

    assert end(1) == end(1)
    assert end(1) != end(2)
    assert end(1).heading_rad != 0.0


@pytest.mark.parametrize("sides", [("left", "left"), ("right", "right")])
def test_a_base_needs_both_sides(sides):
    wheels = {"a": Wheel(MODEL), "b": Wheel(MODEL)}
    contacts = {
        name: Contact(side=side, wheel_radius_m=0.1)
        for name, side in zip(wheels, sides, strict=True)
    }
    with pytest.raises(ValueError, match="left"):
        Plant(wheels, contacts, 0.5)


@settings(deadline=None)
@given(st.sampled_from([8, 16, 24, 32]), st.integers(0), st.integers(-(10**6), 10**6))
def test_a_counter_wraps_at_its_width_wherever_it_starts(bits, start, counts):
    encoder = Encoder(4096, bits, start)
    middle_of_count_rad = (counts + 0.5) / 4096 * 2 * math.pi
    assert encoder.count(middle_of_count_rad) == (start + counts) % (1 << bits)


def test_a_counter_that_restarts_counts_from_where_the_shaft_stands():
    encoder = Encoder(4096, 32)
    encoder.restart(100.0, 7)
    assert encoder.count(100.0) == 7
    assert encoder.count(100.0 + 2 * math.pi + 1e-6) == 7 + 4096
    assert encoder.count(100.0 - 2 * math.pi + 1e-6) == (7 - 4096) % (1 << 32)
