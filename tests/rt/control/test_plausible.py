# SPDX-License-Identifier: Apache-2.0
"""Checks of implausible feedback, on wheels with the ramp and counters of a drive: each fault is
found, and a healthy robot causes none."""

import math
import random
from collections.abc import Callable

import pytest
from _motord_rt import lib
from tests.rt.core_rig import (
    RAD_PER_COUNT,
    TICK_S,
    Rig,
    assert_rest,
    core_config,
    joint_config,
)

TOP_RAD_S = 15.0
CHECKS = {
    "setpoint_min_rad_s": 1.5,
    "slow_rad_s": 0.3,
    "short_rad_s": 6.0,
    "beyond_rad_s": 6.0,
    "apart_rad_s": 1.53,
    "progress_rad_s": 0.15,
    "direction_s": 0.5,
    "stall_s": 1.0,
    "following_s": 1.0,
    "runaway_s": 0.5,
    "apart_s": 1.0,
    "jumps_max": 3,
}
SAMPLE_EVERY = 10
LEFT = 0


class Wheels(Rig):
    """Wheels that follow by `slope_rad_s2` and report every 10 ms. `truth` changes how a wheel
    turns, `sent` what it reports: counter angle and velocity."""

    def __init__(self, *, slope_rad_s2=80.0, reports=True, bits=32, **changes):
        joints = [joint_config(side, counter_bits=bits, plausible=CHECKS) for side in (-1.0, 1.0)]
        super().__init__(core_config(2, joint=joints, **changes))
        self.slope_rad_s2 = slope_rad_s2
        self.reports = reports
        self.truth: Callable[[int, float], float] = lambda joint, wanted_rad_s: wanted_rad_s
        self.sent: Callable[[int, float, float], tuple[float, float]] = (
            lambda joint, angle_rad, speed_rad_s: (angle_rad, speed_rad_s)
        )

    def follow(self, dt_s):
        received = self.input.now_ns // 1_000_000 % SAMPLE_EVERY == 0
        for j, feedback in enumerate(self.feedback):
            wanted = self.out.joint[j].velocity_rad_s if self.out.enabled else 0.0
            step = self.truth(j, wanted) - self.wheel_rad_s[j]
            most = self.slope_rad_s2 * dt_s
            self.wheel_rad_s[j] += max(-most, min(most, step))
            self.position_rad[j] += self.wheel_rad_s[j] * dt_s
            if received:
                angle_rad, speed_rad_s = self.sent(j, self.position_rad[j], self.wheel_rad_s[j])
                bits = self.config.joint[j].counter_bits or 64
                feedback.count = math.floor(angle_rad / RAD_PER_COUNT) % (1 << bits)
                feedback.velocity_rad_s = speed_rad_s if self.reports else math.nan
                feedback.stamp_ns = self.input.now_ns

    def arm(self):
        self.ticks(0.02)
        return super().arm()

    def without_fault(self, *speeds_m_s, seconds=3.0):
        """Drive at each speed for `seconds`; assert that there is no fault."""
        self.arm()
        for speed_m_s in speeds_m_s:
            self.drive(speed_m_s)
            self.ticks(seconds)
            assert self.shown.faults == 0

    def until_fault(self, within_s):
        """Return the time to the first fault in seconds; infinity without one in `within_s`."""
        for tick in range(round(within_s / TICK_S)):
            if self.tick().faults:
                return tick * TICK_S
        return math.inf


def left_sends(rig, sent):
    rig.sent = lambda j, *measured: sent(*measured) if j == LEFT else measured


def left_turns(rig, truth):
    rig.truth = lambda j, wanted: truth(wanted) if j == LEFT else wanted


def frozen_counter(rig):
    at_rad = rig.position_rad[LEFT]
    left_sends(rig, lambda _, speed: (at_rad, speed))


def frozen_feedback(rig):
    at_rad = rig.position_rad[LEFT]
    left_sends(rig, lambda *_: (at_rad, 0.0))


def wild_velocity(rig):
    signs = random.Random(20)
    left_sends(rig, lambda angle, _: (angle, signs.choice((-343.0, 343.0))))


def reversed_feedback(rig):
    turn_rad = 2.0 * rig.position_rad[LEFT]
    left_sends(rig, lambda angle, speed: (turn_rad - angle, -speed))


def jumping(rig):
    steps = random.Random(8)
    left_sends(rig, lambda angle, speed: (angle + steps.choice((0.0, 50.0, 100.0, 200.0)), speed))


def blocked(rig):
    left_turns(rig, lambda _: 0.0)


def weak(rig):
    left_turns(rig, lambda wanted: math.copysign(min(abs(wanted), 2.0), wanted))


def running_away(rig):
    left_turns(rig, lambda wanted: math.copysign(TOP_RAD_S, wanted))


CASES = [
    (frozen_counter, True, 0.5, "FAULT_IMPLAUSIBLE_FEEDBACK"),
    (frozen_counter, False, 0.5, "FAULT_STALL"),
    (frozen_feedback, True, 0.5, "FAULT_STALL"),
    (wild_velocity, True, 0.5, "FAULT_IMPLAUSIBLE_FEEDBACK"),
    (blocked, True, 0.5, "FAULT_STALL"),
    (blocked, False, 0.5, "FAULT_STALL"),
    (reversed_feedback, True, 0.5, "FAULT_DIRECTION"),
    (reversed_feedback, False, 0.5, "FAULT_DIRECTION"),
    (weak, True, 1.0, "FAULT_FOLLOWING_ERROR"),
    (weak, False, 1.0, "FAULT_FOLLOWING_ERROR"),
    (running_away, True, 0.5, "FAULT_RUNAWAY"),
    (running_away, False, 0.5, "FAULT_RUNAWAY"),
    (jumping, True, 0.5, "FAULT_IMPLAUSIBLE_FEEDBACK"),
    (jumping, False, 0.5, "FAULT_IMPLAUSIBLE_FEEDBACK"),
]


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(("happen", "reports", "speed_m_s", "fault"), CASES)
def test_implausible_feedback_or_ignored_set_points_are_a_fault_within_two_seconds(
    happen, reports, speed_m_s, fault, direction
):
    rig = Wheels(reports=reports)
    rig.moving(speed_m_s * direction)
    happen(rig)
    assert rig.until_fault(2.0) < 2.0
    assert rig.shown.faults == getattr(lib, fault)
    assert (rig.shown.doubt.fault, rig.shown.doubt.joint) == (rig.shown.faults, LEFT)
    assert rig.shown.doubt.setpoint_rad_s * direction == pytest.approx(10.0 * speed_m_s, abs=0.5)
    assert 0 < rig.shown.doubt.since_ns < rig.input.now_ns
    assert rig.shown.armed == 0
    rig.ticks(4.0)
    assert_rest(rig, enabled=0)


def test_a_wheel_that_turns_in_the_wrong_direction_loses_its_power_sooner():
    rig = Wheels()
    rig.moving()
    left_turns(rig, lambda wanted: -8.0 if rig.out.enabled else wanted)
    rig.until_fault(2.0)
    rig.ticks(0.8)
    assert rig.shown.faults & lib.FAULT_RUNAWAY
    assert_rest(rig, enabled=0)


# ------------------------------------------------------------------------ what healthy robots do


@pytest.mark.parametrize("reports", [True, False])
@pytest.mark.parametrize("slope_rad_s2", [1.0, 2.0, 5.0, 80.0])
@pytest.mark.parametrize("action", ["STOP_RAMP", "STOP_BRAKE"])
def test_a_drive_whose_own_ramp_is_much_slower_only_lags(slope_rad_s2, reports, action):
    rig = Wheels(slope_rad_s2=slope_rad_s2, reports=reports, on_timeout=getattr(lib, action))
    rig.without_fault(1.0, -1.0, 0.0, 0.5, 1.0, seconds=6.0)
    rig.input.control.stop = 1
    rig.ticks(15.0)
    assert rig.shown.faults == 0


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("reports", [True, False])
def test_constantly_changing_commands_cause_no_fault(seed, reports):
    rig = Wheels(slope_rad_s2=random.Random(seed).choice((3.0, 20.0, 80.0)), reports=reports)
    rig.arm()
    operator = random.Random(f"operator {seed}")
    for _ in range(40):
        rig.drive(operator.uniform(-1.0, 1.0), operator.uniform(-2.0, 2.0))
        rig.ticks(operator.uniform(0.05, 1.5))
        assert rig.shown.faults == 0


@pytest.mark.parametrize("delay_s", [0.1, 0.5, 0.7])
def test_a_drive_that_starts_late_causes_no_fault(delay_s):
    """Such drives open a brake first, or magnetise their motor."""
    rig = Wheels(reports=False)
    rig.arm()
    ready_ns = rig.input.now_ns + round((delay_s + 0.15) * 1e9)
    rig.truth = lambda j, wanted: wanted if rig.input.now_ns > ready_ns else 0.0
    rig.drive(1.0)
    assert rig.until_fault(4.0) == math.inf


@pytest.mark.parametrize("renewed_every_s", [0.05, 0.1, 0.2])
def test_a_slowly_updated_counter_causes_no_fault(renewed_every_s):
    rig = Wheels()
    seen = {}

    def late(j, angle_rad, speed_rad_s):
        number = round(rig.input.now_ns * 1e-9 / renewed_every_s)
        if seen.get(j, (None,))[0] != number:
            seen[j] = (number, angle_rad)
        return seen[j][1], speed_rad_s

    rig.sent = late
    rig.without_fault(0.3, 1.0, -1.0, 0.1)


@pytest.mark.parametrize("lag_s", [0.05, 0.3])
def test_a_filtered_reported_velocity_causes_no_fault(lag_s):
    rig = Wheels()
    shown = [0.0, 0.0]

    def filtered(j, angle_rad, speed_rad_s):
        shown[j] += (speed_rad_s - shown[j]) * 0.01 / (lag_s + 0.01)
        return angle_rad, round(shown[j] * 9.55) / 9.55

    rig.sent = filtered
    rig.without_fault(1.0, -1.0, 0.05, 0.0)


def test_wheels_that_measure_nothing_are_never_doubted():
    rig = Wheels(bits=0, reports=False)
    rig.moving()
    blocked(rig)
    assert rig.until_fault(3.0) == math.inf


def test_a_reported_velocity_without_a_counter_that_no_wheel_has_is_a_fault():
    rig = Wheels(bits=0)
    rig.moving()
    wild_velocity(rig)
    assert rig.until_fault(2.0) < 2.0
    assert rig.shown.faults == lib.FAULT_IMPLAUSIBLE_FEEDBACK
