# SPDX-License-Identifier: Apache-2.0
"""The speed loop against the textbook, and on wheels whose drives take a torque: it holds the
speed and releases a wheel that is impossibly fast."""

import math

import numpy as np
import pytest
from _motord_rt import ffi, lib
from hypothesis import given, reject
from hypothesis import strategies as st
from tests.rt.core_rig import TICK_S, Rig, core_config, joint_config, torque_loop
from tests.rt.speed_loop_oracle import Gains, OnTheEdge, outputs

TORQUE_MAX_N_M = 8.0
INERTIA_KG_M2, FRICTION_N_M = 0.07, 0.3
SPEED_M_S, RADIUS_M = 0.5, 0.1
REST = pytest.approx(0.0, abs=0.01)
"""Speed of a wheel at rest, also with an integral that balances the friction: much lower than
rest_velocity_rad_s."""
anything = st.floats(width=64)
REST_RAD_S = 0.05


class Loop:
    """One loop by itself. `begun`: whether it has made a step before."""

    def __init__(self, config=None, begun=1, **state):
        self.state = ffi.new("speed_loop_state *", {"begun": begun} | state)
        self.config = ffi.new("speed_loop_config *", config or torque_loop())

    def step(self, want_rad_s, measured_rad_s, dt_s=TICK_S):
        step = ffi.new(
            "speed_loop_input *",
            {
                "want_rad_s": want_rad_s,
                "measured_rad_s": measured_rad_s,
                "rest_rad_s": REST_RAD_S,
                "low_u": self.config.output_min_u,
                "high_u": self.config.output_max_u,
            },
        )
        gains = ffi.addressof(self.config, "gains")
        return lib.speed_loop_step(self.state, self.config, gains, step, dt_s)


class TorqueRig(Rig):
    """Wheels with inertia and friction, turned by the torque that the core sets."""

    def __init__(self, **changes):
        joints = [joint_config(side, speed_loop=torque_loop()) for side in (-1.0, 1.0)]
        super().__init__(core_config(2, joint=joints, **changes))
        self.sign = [1.0, 1.0]

    @property
    def torques(self):
        return [self.out.joint[j].torque_n_m for j in range(2)]

    def follow(self, dt_s):
        for j, feedback in enumerate(self.feedback):
            push = self.sign[j] * self.out.joint[j].torque_n_m if self.out.enabled else 0.0
            moved = self.wheel_rad_s[j] + push * dt_s / INERTIA_KG_M2
            held = FRICTION_N_M * dt_s / INERTIA_KG_M2
            speed = 0.0 if abs(moved) <= held else moved - math.copysign(held, moved)
            self.wheel_rad_s[j] = speed
            self.position_rad[j] += speed * dt_s
            feedback.count = math.floor(
                self.position_rad[j] / self.config.joint[j].rad_per_count
            ) % (1 << 32)
            feedback.velocity_rad_s = speed
            feedback.stamp_ns = self.input.now_ns


@given(want=anything, measured=anything, integral=anything, dt_s=anything)
def test_the_torque_is_finite_and_within_its_limit_for_any_input(want, measured, integral, dt_s):
    loop = Loop(integral_u=integral)
    torque = loop.step(want, measured, dt_s)
    assert abs(torque) <= TORQUE_MAX_N_M
    assert math.isfinite(loop.state.integral_u) or not math.isfinite(integral)
    if not math.isfinite(want - measured + integral) or not dt_s > 0:
        assert (torque, loop.state.integral_u) == (0.0, 0.0)


gain = st.floats(0.0, 5.0)
speeds = st.lists(
    st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), min_size=1, max_size=60
)


@given(
    run=speeds, limits=st.tuples(st.floats(0.1, 10.0), st.floats(-20.0, 0.0), st.floats(0.0, 20.0)),
    gains=st.tuples(gain, st.floats(0.001, 20.0), gain, gain, gain, st.floats(0.0, 0.1)),
    filter_s=st.floats(0.0, 0.5), dt_s=st.floats(0.0005, 0.1),
)  # fmt: skip
def test_a_run_matches_the_textbook(run, limits, gains, filter_s, dt_s):
    # rest has a rule of its own, so no sample is that slow while its set-point is zero
    want, measured = np.array([(w, m if w or abs(m) > REST_RAD_S else 1.0) for w, m in run]).T
    names = ("proportional", "integral", "derivative", "static", "viscous", "acceleration")
    correction, low, high = limits
    textbook = Gains(
        **dict(zip(names, gains, strict=True)),
        filter_s=filter_s, correction_max=correction, low=low, high=high,
    )  # fmt: skip
    loop = Loop(
        {
            "gains": gains, "filter_s": filter_s, "correction_max_u": correction,
            "output_min_u": low, "output_max_u": high, "kind": lib.SPEED_LOOP_DUTY,
        },
        slow_rad_s=measured[0],
    )  # fmt: skip
    found = [loop.step(w, m, dt_s) for w, m in zip(want, measured, strict=True)]
    try:
        expected = outputs(textbook, want, measured, dt_s)
    except OnTheEdge:
        reject()
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(run=speeds, most=st.floats(0.1, 10.0), proportional=gain, integral=gain)
def test_without_feed_forward_and_derivative_it_is_the_plain_pi_bit_for_bit(
    run, most, proportional, integral
):
    """Robot files without the newer gains get this loop."""
    loop, total = Loop(torque_loop(proportional, integral, most)), 0.0
    for want, measured in run:
        error = want - measured
        summed = min(max(total + integral * error * TICK_S, -most), most)
        wanted = proportional * error + summed
        torque = min(max(wanted, -most), most)
        if torque == wanted or error * wanted < 0.0:
            total = summed
        assert loop.step(want, measured) == torque


@given(
    speeds=st.tuples(*[st.floats(-15.0, 15.0)] * 2), held=st.floats(-2.0, 2.0),
    gains=st.tuples(*[st.floats(0.01, 0.5)] * 4, st.just(0.0), st.just(0.0)),
)  # fmt: skip
def test_a_loop_that_starts_or_changes_gains_continues_from_the_last_output(speeds, held, gains):
    want, measured = speeds
    if want == 0.0 and abs(measured) < REST_RAD_S:
        return
    loop = Loop(torque_loop(most_n_m=100.0) | {"gains": gains}, begun=0, output_u=held)
    step_u = gains[1] * (want - measured) * TICK_S
    assert loop.step(want, measured) == pytest.approx(held + step_u, abs=1e-9)


def test_wheels_reach_the_commanded_speed_and_rest():
    rig = TorqueRig()
    rig.moving(SPEED_M_S)
    assert rig.wheel_rad_s == pytest.approx([SPEED_M_S / RADIUS_M] * 2, abs=0.02)
    assert rig.torques == pytest.approx([FRICTION_N_M] * 2, abs=0.05)
    rig.drive(0.0)
    rig.ticks(3.0)
    assert max(map(abs, rig.wheel_rad_s)) == REST


@pytest.mark.parametrize("action", ["STOP_RAMP", "STOP_BRAKE", "STOP_HOLD"])
def test_a_stop_is_driven_to_rest_by_the_loop(action):
    rig = TorqueRig(on_timeout=getattr(lib, action))
    rig.moving(SPEED_M_S)
    rig.input.control.stop = 1
    rig.ticks(1.5)
    assert max(map(abs, rig.wheel_rad_s)) == REST
    assert rig.out.enabled == 1


@pytest.mark.parametrize("wheel", [0, 1])
def test_a_wheel_that_runs_in_the_wrong_direction_loses_its_power_with_a_fault(wheel):
    rig = TorqueRig()
    rig.sign[wheel] = -1.0
    rig.arm()
    rig.drive(SPEED_M_S)
    fastest = 0.0
    for _ in range(3000):
        rig.tick()
        fastest = max(fastest, abs(rig.wheel_rad_s[wheel]))
    assert rig.shown.faults == lib.FAULT_OVERSPEED
    assert fastest < 1.6 * 15.0
    assert (rig.out.enabled, rig.torques) == (0, [0.0, 0.0])
    assert rig.wheel_rad_s[1 - wheel] == REST
