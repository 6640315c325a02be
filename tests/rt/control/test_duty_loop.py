# SPDX-License-Identifier: Apache-2.0
"""Wheels on duties with speed loops, closed over the simulator's motor with friction and a coarse
encoder that is read at 100 Hz, as on a maker's robot with PWM bridges."""

import math

import pytest
from _motord_rt import lib
from tests.rt.core_rig import RADIUS_M, Rig, core_config, joint_config

from motord_hal.sim.plant import Wheel, WheelModel

FULL_RAD_S, DEAD_BAND = 18.0, 0.05
SPEED_M_S = 0.5
SPEED_RAD_S = SPEED_M_S / RADIUS_M
RAD_PER_COUNT = 2.0 * math.pi / 1320
EVERY_TICKS = 10
GAINS = {"gain_u_s_per_rad": 0.06, "integral_u_per_rad": 0.4}
MAP = {"static_u": DEAD_BAND, "viscous_u_s_per_rad": (1.0 - DEAD_BAND) / FULL_RAD_S}
HEAVY = WheelModel(coulomb_n_m=1.2)
"""Wheel that begins to turn at a duty of 15 %, and turns a quarter slower than configured."""


def duty_loop(gains=GAINS, **changes):
    return {
        "gains": MAP | gains,
        "filter_s": 0.05,
        "correction_max_u": 0.3,
        "output_min_u": -1.0,
        "output_max_u": 1.0,
        "kind": lib.SPEED_LOOP_DUTY,
    } | changes


class DutyRig(Rig):
    """Two wheels on duties. `push_n_m`: torque of a slope on each wheel."""

    def __init__(self, loop=None):
        pwm = {"dead_band": DEAD_BAND, "duty_min": -1.0, "duty_max": 1.0}
        pwm |= {"slew_per_s": math.inf, "full_duty_rad_s": FULL_RAD_S}
        joints = [
            joint_config(side, pwm=pwm, rad_per_count=RAD_PER_COUNT, speed_loop=loop or duty_loop())
            for side in (-1.0, 1.0)
        ]
        super().__init__(core_config(2, joint=joints))
        self.wheels = [Wheel(HEAVY), Wheel(HEAVY)]
        self.push_n_m = [0.0, 0.0]
        self.sign = [1.0, 1.0]
        self.frozen = set()
        """Wheels whose encoder no longer counts."""

    def follow(self, dt_s):
        for j, wheel in enumerate(self.wheels):
            if self.out.enabled:
                wheel.push(self.out.joint[j].duty * self.sign[j], FULL_RAD_S)
            else:
                wheel.coast()
            wheel.velocity_rad_s += self.push_n_m[j] * dt_s / wheel.model.inertia_kg_m2
            wheel.substep(dt_s)
            if self.state.tick % EVERY_TICKS == 0:
                if j not in self.frozen:
                    count = math.floor(wheel.position_rad / RAD_PER_COUNT)
                    self.feedback[j].count = count % (1 << 32)
                self.feedback[j].velocity_rad_s = math.nan
                self.feedback[j].stamp_ns = self.input.now_ns

    @property
    def speeds_rad_s(self):
        return [wheel.velocity_rad_s for wheel in self.wheels]

    def mean_rad_s(self, seconds):
        before = [wheel.position_rad for wheel in self.wheels]
        self.ticks(seconds)
        after = [wheel.position_rad for wheel in self.wheels]
        return [(b - a) / seconds for a, b in zip(before, after, strict=True)]

    def check_feedback(self):
        """Restart the core with the defaults of [safety.feedback]."""
        for joint in self.config.joint[0:2]:
            checks = joint.plausible
            checks.setpoint_min_rad_s, checks.slow_rad_s = 0.5, 0.1
            checks.direction_s, checks.stall_s = 0.5, 1.0
        assert lib.core_init(self.state, self.config) == 0


def test_friction_missing_from_the_robot_file_is_compensated():
    plain = DutyRig(duty_loop({}))
    plain.moving(SPEED_M_S)
    assert max(plain.mean_rad_s(1.0)) < 0.9 * SPEED_RAD_S
    rig = DutyRig()
    rig.moving(SPEED_M_S)
    assert rig.mean_rad_s(1.0) == pytest.approx([SPEED_RAD_S] * 2, rel=0.01)


def test_a_step_settles_without_much_overshoot_and_comes_to_a_duty_of_zero():
    rig = DutyRig()
    rig.arm()
    rig.drive(SPEED_M_S)
    fastest = 0.0
    for _ in range(3000):
        rig.tick()
        fastest = max(fastest, *rig.speeds_rad_s)
    assert fastest < 1.2 * SPEED_RAD_S
    rig.drive(0.0)
    rig.ticks(3.0)
    assert rig.speeds_rad_s == [0.0, 0.0]
    assert [rig.out.joint[j].duty for j in range(2)] == [0.0, 0.0]
    assert [rig.state.speed_loop[j].integral_u for j in range(2)] == [0.0, 0.0]
    assert rig.shown.at_rest == 1
    assert rig.shown.faults == 0


@pytest.mark.parametrize("push_n_m", [-1.0, 1.0])
def test_a_slope_is_held(push_n_m):
    rig = DutyRig()
    rig.moving(SPEED_M_S)
    rig.push_n_m = [push_n_m, push_n_m]
    rig.ticks(1.5)
    assert rig.mean_rad_s(1.0) == pytest.approx([SPEED_RAD_S] * 2, rel=0.02)


def test_a_single_wheel_is_corrected_so_that_the_robot_goes_straight():
    rig = DutyRig()
    rig.moving(SPEED_M_S)
    rig.push_n_m = [-1.0, 0.0]
    rig.ticks(1.5)
    left, right = rig.mean_rad_s(1.0)
    assert left == pytest.approx(right, rel=0.01)


def test_saturation_winds_nothing_up():
    """A wheel that is held back for seconds comes back to its speed without running beyond it."""
    rig = DutyRig(duty_loop(output_max_u=0.4))
    rig.moving(SPEED_M_S)
    rig.push_n_m = [-2.0, -2.0]
    rig.ticks(0.8)
    assert max(rig.speeds_rad_s) < 0.8 * SPEED_RAD_S
    rig.push_n_m = [0.0, 0.0]
    fastest = 0.0
    for _ in range(2000):
        rig.tick()
        fastest = max(fastest, *rig.speeds_rad_s)
    assert rig.shown.faults == 0
    assert fastest < 1.2 * SPEED_RAD_S


def test_a_stopped_encoder_adds_at_most_the_correction_and_stops_the_robot():
    rig = DutyRig()
    rig.check_feedback()
    rig.moving(SPEED_M_S)
    fed = MAP["static_u"] + MAP["viscous_u_s_per_rad"] * SPEED_RAD_S
    assert rig.out.joint[0].duty < fed + 0.2
    rig.frozen = {0}
    while not rig.shown.faults and rig.state.tick < 10_000:
        rig.tick()
        assert rig.out.joint[0].duty <= fed + 0.3 + 1e-9
    assert rig.shown.faults == lib.FAULT_STALL
    rig.ticks(6.0)
    assert rig.speeds_rad_s == [0.0, 0.0]


@pytest.mark.parametrize("wheel", [0, 1])
def test_a_wheel_with_its_encoder_reversed_is_stopped(wheel):
    rig = DutyRig()
    rig.check_feedback()
    rig.sign[wheel] = -1.0
    rig.arm()
    rig.drive(SPEED_M_S)
    fastest = 0.0
    for _ in range(6000):
        rig.tick()
        fastest = max(fastest, *map(abs, rig.speeds_rad_s))
    assert rig.shown.faults & (lib.FAULT_DIRECTION | lib.FAULT_OVERSPEED)
    assert fastest < (0.3 + MAP["static_u"] + 0.3) * FULL_RAD_S
    assert rig.speeds_rad_s == [0.0, 0.0]
    assert rig.out.enabled == 0
