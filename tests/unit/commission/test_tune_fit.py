# SPDX-License-Identifier: Apache-2.0
"""Fit of a wheel's model to its response to steps: it finds the known inertia, friction and dead
time of the simulator's wheel, and the gains are those of the tuning rule (SIMC)."""

import random

import numpy as np
import pytest

from motord.commission.person import Failed
from motord.commission.tune.fit import (
    CLOSED_LOOP,
    Plant,
    Run,
    gains_of,
    identify,
    response_of,
)
from motord_hal.sim.plant import SUBSTEP_S, Wheel, WheelModel

FULL_RAD_S = 18.0


def ramped(peak, acceleration, hold_s):
    """Return moments in steps of the simulator, and a speed that rises, holds, falls and rests."""
    rise_s = abs(peak) / acceleration
    moments = np.arange(0.0, 2.0 * rise_s + hold_s + 0.4, SUBSTEP_S)
    knots = [0.0, rise_s, rise_s + hold_s, 2.0 * rise_s + hold_s]
    return moments, np.interp(moments, knots, [0.0, peak, peak, 0.0])


def run_of(model, peak, *, dead_s=0.03, cycle_s=0.02, look_s=0.01, resolution=0.1, seed=0):
    """Return a run of a wheel that the open-loop map drives, measured as a drive measures it."""
    wheel, chance = Wheel(model), random.Random(seed)
    moments, want = ramped(peak, 10.0, 0.8)
    duty = np.where(want == 0.0, 0.0, 0.05 * np.sign(want) + want * 0.95 / FULL_RAD_S)
    delay = round(dead_s / SUBSTEP_S)
    measured_s, speeds, due_s = [], [], 0.0
    for number, moment in enumerate(moments):
        wheel.push(float(duty[max(number - delay, 0)]), FULL_RAD_S)
        wheel.substep(SUBSTEP_S)
        if moment >= due_s:
            due_s += cycle_s * (1.0 + 0.1 * chance.random())
            measured_s.append(moment)
            speeds.append(round(wheel.velocity_rad_s / resolution) * resolution)
    shown = slice(None, None, round(look_s / SUBSTEP_S))
    return Run(moments[shown], want[shown], duty[shown], np.array(measured_s), np.array(speeds))


@pytest.mark.parametrize("dead_s", [0.0, 0.03, 0.08])
@pytest.mark.parametrize("coulomb_n_m", [0.1, 0.6, 1.2])
@pytest.mark.parametrize("inertia_kg_m2", [0.02, 0.07, 0.2])
def test_a_fit_finds_inertia_friction_and_dead_time(inertia_kg_m2, coulomb_n_m, dead_s):
    model = WheelModel(inertia_kg_m2=inertia_kg_m2, coulomb_n_m=coulomb_n_m)
    runs = [run_of(model, peak, dead_s=dead_s, seed=n) for n, peak in enumerate((4, 8, -4, -8))]
    found = identify("left", runs)
    stall = model.torque_max_n_m
    # at 0.02 kg m² the time constant is two samples: a part of it appears as dead time
    part = 0.3 if inertia_kg_m2 < 0.05 else 0.08
    assert found.acceleration_u_s2_per_rad == pytest.approx(inertia_kg_m2 / stall, rel=part)
    viscous = 1.0 / FULL_RAD_S + model.viscous_n_m_s_rad / stall
    assert found.viscous_u_s_per_rad == pytest.approx(viscous, rel=0.03)
    assert found.static_u == pytest.approx(coulomb_n_m / stall, abs=0.006)
    assert found.dead_time_s == pytest.approx(dead_s, abs=0.012)
    assert found.misfit_rad_s < 0.1


def held_up_run(model, peak, *, holds=()):
    """Return a run of a wheel under a torque loop; each measure is 10 ms old. `holds`: (part,
    begin, end) of each pause: "tool" sees nothing meanwhile, "loop" keeps its output, "line" brings
    no set-point to the drive and no measure back."""
    wheel, integral, torque, output = Wheel(model), 0.0, 0.0, 0.0
    moments, want = ramped(peak, 10.0, 0.8)
    seen = {"time": [], "want": [], "output": [], "measured": [], "speed": []}
    measures, latest = [], (0.0, 0.0)
    for number, moment in enumerate(moments):
        stopped = {what for what, begin_s, end_s in holds if begin_s <= moment < end_s}
        if number % 10 == 0:
            measures.append((moment, wheel.velocity_rad_s))
        if not stopped & {"line", "loop"}:
            latest = next((one for one in reversed(measures) if one[0] <= moment - 0.01), latest)
        if "loop" not in stopped:
            error = want[number] - latest[1]
            integral += 4.0 * error * SUBSTEP_S
            output = max(-3.0, min(3.0, error + integral))
        if not stopped & {"line", "loop"}:
            torque = output
        wheel.drive(torque)
        wheel.substep(SUBSTEP_S)
        if number % 10 == 5 and not stopped & {"tool", "loop"}:
            seen["time"].append(moment)
            seen["want"].append(want[number])
            seen["output"].append(output)
            if not seen["measured"] or latest[0] > seen["measured"][-1]:
                seen["measured"].append(latest[0])
                seen["speed"].append(latest[1])
    return Run(*map(np.array, seen.values()))


@pytest.mark.parametrize("what", ["tool", "loop", "line"])
@pytest.mark.parametrize("begin_s", [0.1, 0.3, 0.6, 1.3])
def test_pauses_of_the_computer_do_not_distort_the_fit(what, begin_s):
    """Speed that a torque has added to a wheel stays: a moment that the tool has not seen must not
    distort the rest of the run."""
    model = WheelModel()
    holds = [(what, begin_s, begin_s + 0.12), (what, begin_s + 0.35, begin_s + 0.45)]
    found = identify("left", [held_up_run(model, peak, holds=holds) for peak in (2, 4, -2, -4)])
    assert found.acceleration_u_s2_per_rad == pytest.approx(model.inertia_kg_m2, rel=0.1)
    assert found.static_u == pytest.approx(model.coulomb_n_m, rel=0.1)
    assert found.viscous_u_s_per_rad == pytest.approx(model.viscous_n_m_s_rad, abs=0.012)
    assert found.misfit_rad_s < 0.1


PLANT = Plant(
    acceleration_u_s2_per_rad=0.008, viscous_u_s_per_rad=0.05, static_u=0.05, dead_time_s=0.03,
    misfit_rad_s=0.05, sample_s=0.02,
)  # fmt: skip


def test_gains_are_those_of_simc():
    found = gains_of(PLANT, "brisk")
    assert found.gain_u_s_per_rad == pytest.approx(0.16 / (20.0 * 0.06))
    assert found.integral_u_per_rad == pytest.approx(found.gain_u_s_per_rad / 0.16)


def test_gentler_settings_give_less_gain_and_the_sample_time_limits_it():
    gains = [gains_of(PLANT, how).gain_u_s_per_rad for how in ("gentle", "normal", "brisk")]
    assert gains == sorted(gains)
    assert set(CLOSED_LOOP) == {"gentle", "normal", "brisk"}
    slow = Plant(
        acceleration_u_s2_per_rad=0.008, viscous_u_s_per_rad=0.05, static_u=0.05, dead_time_s=0.0,
        misfit_rad_s=0.05, sample_s=0.04,
    )  # fmt: skip
    assert gains_of(slow, "brisk").gain_u_s_per_rad == pytest.approx(0.008 / 0.08)


def test_a_wheel_that_does_not_turn_is_refused():
    stuck = WheelModel(coulomb_n_m=9.0)
    with pytest.raises(Failed, match=r"turned with 0\.00 of 8\.00 rad/s"):
        identify("left", [run_of(stuck, 8.0)])
    with pytest.raises(Failed, match="turned with"):
        identify("left", [])


def test_a_wheel_that_holds_its_speed_by_itself_is_refused():
    run = run_of(WheelModel(), 8.0)
    noise = np.random.default_rng(1).normal(0.0, 3.0, len(run.speed_rad_s))
    wild = Run(run.time_s, run.want_rad_s, run.output_u, run.measured_s, run.speed_rad_s + noise)
    with pytest.raises(Failed, match="answers as no motor with friction does"):
        identify("left", [wild])


def test_a_response_is_measured_against_its_set_point():
    moments, want = ramped(5.0, 10.0, 1.0)
    exact = Run(moments, want, want, moments, want)
    assert response_of([exact]).error_rad_s == 0.0
    slow = Run(moments, want, want, moments, 0.8 * want)
    found = response_of([slow])
    assert found.off_rad_s == pytest.approx(1.0)
    assert found.error_rad_s > 0.5
    over = Run(moments, want, want, moments, 1.1 * want)
    assert response_of([over]).overshoot_rad_s == pytest.approx(0.5)
    kicked = np.where((moments > 1.3) & (moments < 1.5), 3.0 * want, want)
    late = (moments < 1.3) | (moments > 1.47)
    parts = (moments[late], want[late], want[late], moments[late], kicked[late])
    assert response_of([Run(*parts)]).overshoot_rad_s == 0.0
    with pytest.raises(Failed, match="got no set-point"):
        response_of([Run(moments, 0.0 * want, want, moments, want)])
