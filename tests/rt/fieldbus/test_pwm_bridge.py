# SPDX-License-Identifier: Apache-2.0
"""Motor bridges in C: the levels of the pins, and that only armed, enabled and fresh set-points
move a motor."""

import math

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.shipped import NAMES, shipped_profile

from motord_hal.realtime.pwm import MODES

NOW_NS = 10_000_000_000
TIMEOUT_NS = 100_000_000
STOPPING_NS = 300_000_000
PERIOD_NS = 50_000
BRIDGES = [name for name in NAMES if shipped_profile(name).bridge]


class Bench:
    """One bridge; the test sets the time."""

    def __init__(self, drive="bts7960", inverted=False):
        self.bridge = shipped_profile(drive).bridge
        self.pins = list(self.bridge.levels)
        self.state = ffi.new("bridge_state *")
        self.control = ffi.new("bridge_control *")
        self.newest = ffi.new("setpoints *", {"joint_count": 1, "stamp_ns": NOW_NS})
        self.config = ffi.new("bridge_config *")
        self.config.outputs_fd, self.config.inputs_fd = 99, -1
        self.config.period_ns, self.config.setpoint_timeout_ns = 5_000_000, TIMEOUT_NS
        self.config.stopping_ns = STOPPING_NS
        self.config.joint_count, self.config.output_count = 1, len(self.pins)
        self.config.joint[0].sign = -1.0 if inverted else 1.0
        self.config.joint[0].rest_mode = lib.BRIDGE_BRAKE
        for place, pin in zip(self.config.output, self.pins, strict=False):
            place.fd, place.period_ns = 3, PERIOD_NS
            for number, mode in enumerate(MODES):
                place.base[number], place.slope[number] = self.bridge.levels[pin][mode]
        assert lib.bridge_config_check(self.config) == 0
        self.now_ns = NOW_NS

    @property
    def armed(self):
        return self.state.drive.mode == lib.DRIVE_ARMED

    def request_mode(self, request):
        self.control.mode, self.control.number = request, self.control.number + 1

    def step(self, duty=0.0, enabled=True, age_ns=0, after_ns=1_000_000):
        self.now_ns += after_ns
        self.newest.stamp_ns, self.newest.enabled = self.now_ns - age_ns, enabled
        self.newest.joint[0].duty = duty
        level = ffi.new("double[32]")
        lib.bridge_step(self.state, self.config, self.control, self.newest, self.now_ns, level)
        return dict(zip(self.pins, level, strict=False))

    def levels(self, mode, duty=0.0):
        return {
            pin: pytest.approx(base + slope * duty)
            for pin, (base, slope) in ((p, self.bridge.levels[p][mode]) for p in self.pins)
        }


@pytest.mark.parametrize("drive", BRIDGES)
def test_every_bridge_drives_forward_backward_brakes_and_coasts(drive):
    bench = Bench(drive)
    assert bench.step(0.5) == bench.levels("coast")
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(0.5) == bench.levels("forward", 0.5)
    assert bench.step(-0.25) == bench.levels("reverse", 0.25)
    assert bench.step(0.0) == bench.levels("brake")
    bench.request_mode(lib.PWM_OFF)
    assert bench.step(0.5) == bench.levels("coast")


@pytest.mark.parametrize("drive", BRIDGES)
def test_forward_backward_and_no_power_are_three_different_things(drive):
    levels = shipped_profile(drive).bridge.levels
    modes = {mode: tuple(levels[pin][mode] for pin in levels) for mode in MODES}
    assert len({modes["forward"], modes["reverse"], modes["coast"]}) == 3
    assert all(slope == 0.0 for base, slope in modes["coast"])
    assert all(slope == 0.0 for base, slope in modes["brake"])


@given(
    st.sampled_from(BRIDGES),
    st.lists(
        st.tuples(
            st.floats(allow_nan=True, allow_infinity=True),
            st.booleans(),
            st.integers(0, 2 * TIMEOUT_NS),
            st.integers(0, 2 * TIMEOUT_NS),
            st.sampled_from([None, lib.PWM_OFF, lib.PWM_STOP, lib.PWM_ARMED]),
        ),
        max_size=30,
    ),
)
def test_levels_are_valid_for_any_input_and_only_armed_bridges_move(drive, events):
    bench = Bench(drive)
    for duty, enabled, age_ns, after_ns, request in events:
        if request is not None:
            bench.request_mode(request)
        levels = bench.step(duty, enabled, age_ns, after_ns)
        assert all(0.0 <= level <= 1.0 for level in levels.values())
        may_move = bench.armed and enabled and age_ns <= TIMEOUT_NS
        if not may_move:
            resting = [bench.levels("coast"), bench.levels("brake")]
            assert levels in resting
        if not bench.armed and not bench.state.drive.stopping:
            assert levels == bench.levels("coast")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_duty_that_is_not_finite_is_zero(bad):
    bench = Bench()
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(bad) == bench.levels("brake")


def test_a_duty_beyond_one_counts_as_one():
    bench = Bench()
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(7.0) == bench.levels("forward", 1.0)


def test_an_inverted_motor_turns_in_reverse():
    bench = Bench(inverted=True)
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(0.5) == bench.levels("reverse", 0.5)


def test_old_set_points_brake_then_take_the_power_and_it_stays_off():
    bench = Bench()
    bench.request_mode(lib.PWM_ARMED)
    bench.step(0.5)
    assert bench.step(0.5, age_ns=TIMEOUT_NS + 1) == bench.levels("brake")
    assert bench.state.drive.fault_reasons == lib.DRIVE_FAULT_SETPOINTS_OLD
    assert bench.step(0.5) == bench.levels("brake")
    assert bench.step(0.5, after_ns=STOPPING_NS) == bench.levels("coast")
    assert bench.step(0.5) == bench.levels("coast")


def test_set_points_that_are_no_longer_enabled_take_the_power_at_once():
    bench = Bench()
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(0.5, enabled=False) == bench.levels("brake")  # not enabled before
    bench.step(0.5)
    assert bench.step(0.5, enabled=False) == bench.levels("coast")
    assert bench.step(0.5) == bench.levels("coast")
    assert bench.state.drive.fault_reasons == lib.DRIVE_FAULT_NOT_ENABLED


def test_a_thread_that_was_held_up_does_not_resume_its_motion():
    bench = Bench()
    bench.request_mode(lib.PWM_ARMED)
    bench.step(0.5)
    assert bench.step(0.5, after_ns=TIMEOUT_NS + 1) == bench.levels("brake")
    assert bench.state.drive.fault_reasons == lib.DRIVE_FAULT_LEFT_ALONE


def test_arming_needs_fresh_set_points_and_a_new_request():
    bench = Bench()
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(0.5, age_ns=TIMEOUT_NS + 1) == bench.levels("coast")
    assert bench.step(0.5) == bench.levels("coast")
    bench.request_mode(lib.PWM_ARMED)
    assert bench.step(0.5) == bench.levels("forward", 0.5)


@given(st.floats(0, 1), st.booleans(), st.integers(1, 20_000_000))
def test_a_level_is_a_part_of_the_period(level, inverted, period_ns):
    pin = ffi.new("bridge_pin *", {"inverted": inverted, "period_ns": period_ns})
    duty_ns = lib.bridge_duty_ns(pin, level)
    assert 0 <= duty_ns <= period_ns
    part = 1 - level if inverted else level
    assert duty_ns == pytest.approx(part * period_ns, abs=1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1.1, -0.1])
def test_a_level_beyond_the_period_is_refused(bad):
    bench = Bench()
    bench.config.output[0].base[2] = bad
    assert lib.bridge_config_check(bench.config) < 0
