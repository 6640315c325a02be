# SPDX-License-Identifier: Apache-2.0
"""The speed loop of wheels whose drives take a torque: it holds the speed and keeps to its limit;
without power, without a measure, or beyond all speed there is no torque."""

import math

import pytest
from _motord_rt import ffi, lib
from core_rig import TICK_S, Rig, core_config, joint_config
from hypothesis import given
from hypothesis import strategies as st

TORQUE_MAX_N_M = 8.0
GAINS = {"gain_n_m_s_per_rad": 1.0, "integral_n_m_per_rad": 4.0, "torque_max_n_m": TORQUE_MAX_N_M}
INERTIA_KG_M2, FRICTION_N_M = 0.07, 0.3
SPEED_M_S, RADIUS_M = 0.5, 0.1
REST = pytest.approx(0.0, abs=0.01)
"""Of a loop with an integral that balances the friction: slower than rest_velocity_rad_s by far."""
anything = st.floats(width=64)


class Loop:
    def __init__(self, integral_n_m=0.0, **changes):
        self.state = ffi.new("speed_loop_state *", {"integral_n_m": integral_n_m})
        self.config = ffi.new("speed_loop_config *", GAINS | changes)

    def step(self, want_rad_s, measured_rad_s, dt_s=TICK_S):
        return lib.speed_loop_step(self.state, self.config, want_rad_s, measured_rad_s, dt_s)


class TorqueRig(Rig):
    """Wheels with inertia and friction, turned by the torque that the core wants."""

    def __init__(self, **changes):
        joints = [joint_config(side, speed_loop=GAINS) for side in (-1.0, 1.0)]
        super().__init__(core_config(2, joint=joints, **changes))
        self.sign = [1.0, 1.0]
        self.silent = set()

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
            if j not in self.silent:
                feedback.count = math.floor(
                    self.position_rad[j] / self.config.joint[j].rad_per_count
                ) % (1 << 32)
                feedback.velocity_rad_s = speed
                feedback.stamp_ns = self.input.now_ns


@pytest.fixture
def rig():
    return TorqueRig()


@given(want=anything, measured=anything, integral=anything, dt_s=anything)
def test_the_torque_is_a_number_within_its_limit_whatever_comes(want, measured, integral, dt_s):
    loop = Loop(integral)
    torque = loop.step(want, measured, dt_s)
    assert abs(torque) <= TORQUE_MAX_N_M
    assert math.isfinite(loop.state.integral_n_m) or not math.isfinite(integral)
    if not math.isfinite(want - measured + integral) or not dt_s > 0:
        assert (torque, loop.state.integral_n_m) == (0.0, 0.0)


def test_torque_is_gain_times_error_and_the_sum_of_it():
    loop = Loop()
    assert loop.step(3.0, 1.0) == pytest.approx(2.0 + 4.0 * 2.0 * TICK_S)
    assert loop.step(1.0, 1.0) == pytest.approx(4.0 * 2.0 * TICK_S)


def test_what_the_limit_cuts_off_is_not_summed_up():
    loop = Loop()
    for _ in range(5000):
        assert loop.step(100.0, 0.0) == TORQUE_MAX_N_M
    assert loop.step(0.0, 0.0) == 0.0


def test_wheels_come_to_the_speed_that_was_asked_for_and_to_rest(rig):
    rig.moving(SPEED_M_S)
    assert rig.wheel_rad_s == pytest.approx([SPEED_M_S / RADIUS_M] * 2, abs=0.02)
    assert rig.torques == pytest.approx([FRICTION_N_M] * 2, abs=0.05)
    rig.drive(0.0)
    rig.ticks(3.0)
    assert max(map(abs, rig.wheel_rad_s)) == REST


def test_there_is_no_torque_before_arming_and_none_after(rig):
    rig.drive(0.0)
    rig.wheel_rad_s = [3.0, 3.0]
    rig.ticks(0.01)
    assert rig.torques == [0.0, 0.0]
    rig = TorqueRig()
    rig.moving(SPEED_M_S)
    rig.input.control.armed = 0
    rig.tick()
    assert (rig.out.enabled, rig.torques) == (0, [0.0, 0.0])
    assert [rig.state.speed_loop[j].integral_n_m for j in range(2)] == [0.0, 0.0]


@pytest.mark.parametrize("action", ["STOP_RAMP", "STOP_BRAKE", "STOP_HOLD"])
def test_a_stop_is_driven_to_rest_by_the_loop(action):
    rig = TorqueRig(on_timeout=getattr(lib, action))
    rig.moving(SPEED_M_S)
    rig.input.control.stop = 1
    rig.ticks(1.5)
    assert max(map(abs, rig.wheel_rad_s)) == REST
    assert rig.out.enabled == 1


def test_coasting_is_no_torque_at_once():
    rig = TorqueRig(on_timeout=lib.STOP_COAST)
    rig.moving(SPEED_M_S)
    rig.input.control.stop = 1
    rig.tick()
    assert (rig.out.enabled, rig.torques) == (0, [0.0, 0.0])


def test_a_wheel_that_is_not_received_gets_no_torque_and_the_other_one_is_brought_to_rest(rig):
    rig.moving(SPEED_M_S)
    rig.silent = {0}
    rig.ticks(0.3)
    assert rig.shown.faults == lib.FAULT_FEEDBACK_STALE
    assert rig.torques[0] == 0.0
    assert rig.torques[1] != 0.0
    rig.ticks(1.5)
    assert rig.wheel_rad_s[1] == REST


@pytest.mark.parametrize("wheel", [0, 1])
def test_a_wheel_that_runs_the_wrong_way_is_let_go_and_that_is_a_fault(rig, wheel):
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


def test_after_overspeed_arming_needs_a_reset_and_then_torque_is_there_again(rig):
    rig.moving(SPEED_M_S)
    rig.wheel_rad_s[0] = 30.0
    rig.tick()
    rig.tick()
    assert rig.shown.faults == lib.FAULT_OVERSPEED
    assert rig.torques[0] == 0.0
    rig.drive(0.0)
    rig.ticks(12.0)
    assert rig.out.enabled == 0
    rig.input.control.armed = 0
    rig.reset()
    assert rig.shown.faults == 0
    rig.moving(SPEED_M_S)
    assert rig.wheel_rad_s[0] == pytest.approx(SPEED_M_S / RADIUS_M, abs=0.05)


def test_a_measure_that_is_no_number_is_no_torque(rig):
    rig.moving(SPEED_M_S)
    rig.state.odometry.joint[0].velocity_rad_s = math.nan
    rig.hold.add("feedback")
    rig.tick()
    assert rig.torques[0] == 0.0


def test_a_torque_that_is_no_number_is_a_fault_of_the_core_and_rest(rig):
    rig.moving(SPEED_M_S)
    rig.state.config.joint[1].speed_loop.torque_max_n_m = 0.0
    rig.state.wheels.joint[1].torque_n_m = math.nan
    rig.tick()
    assert rig.shown.faults == lib.FAULT_STATE
    assert rig.torques == [0.0, 0.0]


def test_a_joint_whose_drive_holds_the_speed_has_no_torque():
    rig = Rig()
    rig.moving(SPEED_M_S)
    assert [rig.out.joint[j].torque_n_m for j in range(8)] == [0.0] * 8
