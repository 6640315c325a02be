# SPDX-License-Identifier: Apache-2.0
"""core_step: who may move, and how it all ends at rest."""

import math
import struct
from random import Random
from typing import Any

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st
from tests.rt.core_rig import TICK_NS, Rig, assert_rest, core_config, joint_config

NOT_NUMBERS = [math.nan, math.inf, -math.inf]


def assert_at_rest_after_ramp(rig: Rig, seconds: float = 1.0) -> None:
    rig.ticks(seconds)
    assert_rest(rig)
    assert rig.shown.at_rest == 1


def test_a_joint_that_was_never_received_measures_nothing():
    rig = Rig()
    no_feedback(rig)
    rig.tick()
    joint = rig.shown.joint[0]
    assert math.isnan(joint.voltage_v)
    assert math.isnan(joint.current_a)
    assert math.isnan(joint.temperature_c)
    assert joint.enabled == 2  # it cannot say
    assert joint.feedback_age_s == math.inf


def test_the_reasons_to_stand_are_all_that_are_no_limits():
    names = [name for name in dir(lib) if name.startswith("REASON_")]
    limits = 0xFFFF | lib.REASON_STEERING | lib.REASON_CURVATURE | lib.REASON_TURN_IMPOSSIBLE
    limits |= lib.REASON_DERATED | lib.REASON_JOINT_VELOCITY | lib.REASON_JOINT_ACCELERATION
    limits |= lib.REASON_JOINT_POSITION
    standing = [getattr(lib, name) for name in names if not getattr(lib, name) & limits]
    assert sum(standing) == lib.REASONS_TO_STAND


# ------------------------------------------------------------------------------------------- arming
def test_nothing_moves_before_arming():
    rig = Rig()
    rig.drive(0.5)
    rig.ticks(0.5)
    assert_rest(rig, enabled=0)
    assert rig.shown.reasons & lib.REASON_NOT_ARMED


def test_an_armed_base_goes_as_fast_as_it_is_sent():
    rig = Rig()
    rig.moving(0.5)
    assert rig.speeds == [5.0, 5.0]
    assert rig.out.enabled == 1
    assert rig.shown.reasons == 0
    assert rig.shown.linear_m_s == pytest.approx(0.5, rel=0.4)


def no_feedback(rig: Rig) -> None:
    rig.hold.add("feedback")
    for feedback in rig.feedback:
        feedback.stamp_ns = 0


def future_feedback(rig: Rig) -> None:
    rig.hold.add("feedback")
    rig.feedback[0].stamp_ns = rig.input.now_ns + 20 * TICK_NS


def drive_fault(rig: Rig) -> None:
    rig.feedback[1].drive_faults = 4


def command_not_zero(rig: Rig) -> None:
    rig.drive(0.1)


def command_not_a_number(rig: Rig) -> None:
    rig.drive(math.nan)


def stop_level(rig: Rig) -> None:
    rig.input.control.stop = 1


def estop_level(rig: Rig) -> None:
    rig.input.control.estop = 1


def external_fault(rig: Rig) -> None:
    rig.input.control.fault = 1


def no_heartbeat(rig: Rig) -> None:
    rig.hold.add("heartbeat")
    rig.input.control.heartbeat_ns = 0


def future_heartbeat(rig: Rig) -> None:
    rig.hold.add("heartbeat")
    rig.input.control.heartbeat_ns = rig.input.now_ns + 20 * TICK_NS


OBSTACLES = [
    no_feedback,
    future_feedback,
    drive_fault,
    command_not_zero,
    command_not_a_number,
    stop_level,
    estop_level,
    external_fault,
    no_heartbeat,
    future_heartbeat,
]


@pytest.mark.parametrize("obstacle", OBSTACLES)
def test_arming_is_refused_and_the_edge_is_spent(obstacle):
    rig = Rig()
    rig.tick()
    obstacle(rig)
    rig.input.control.armed = 1
    assert rig.tick().armed == 0
    assert rig.out.enabled == 0
    rig.hold.clear()
    rig.drive(0.0)
    rig.feedback[1].drive_faults = 0
    rig.input.control.stop = rig.input.control.estop = rig.input.control.fault = 0
    rig.tick()
    rig.reset()
    assert rig.shown.faults == 0
    assert rig.tick().armed == 0, "the level alone must not arm"
    rig.input.control.armed = 0
    rig.tick()
    rig.input.control.armed = 1
    assert rig.tick().armed == 1


def test_a_stale_command_is_no_obstacle_to_arming():
    rig = Rig()
    rig.hold.add("command")
    rig.arm()
    assert rig.shown.reasons & lib.REASON_COMMAND_STALE
    assert math.isinf(rig.shown.command_age_s)


def test_disarming_is_zero_and_power_off_at_once():
    rig = Rig()
    rig.moving()
    rig.input.control.armed = 0
    rig.tick()
    assert_rest(rig, enabled=0)
    assert rig.shown.faults == 0


# ------------------------------------------------------------------------------------------ command
@pytest.mark.parametrize("action", ["STOP_RAMP", "STOP_HOLD"])
def test_a_lost_command_ramps_to_rest_and_stays_armed(action):
    rig = Rig(core_config(on_timeout=getattr(lib, action)))
    rig.moving()
    rig.hold.add("command")
    rig.ticks(0.31)
    before = rig.speeds[0]
    rig.tick()
    assert 0.0 < rig.speeds[0] <= before
    assert rig.shown.reasons & lib.REASON_COMMAND_STALE
    assert rig.shown.wanted_linear_m_s == 0.0
    assert_at_rest_after_ramp(rig)
    assert (rig.shown.armed, rig.out.enabled, rig.shown.faults) == (1, 1, 0)
    rig.hold.clear()
    rig.tick()
    rig.ticks(0.1)
    assert rig.speeds[0] > 0.0, "a lost command is not latched"


def test_a_lost_command_brakes_at_once_where_the_robot_file_wants_it():
    rig = Rig(core_config(on_timeout=lib.STOP_BRAKE))
    rig.moving()
    rig.hold.add("command")
    rig.ticks(0.31)
    assert_rest(rig, enabled=1)


def test_a_lost_command_coasts_and_disarms_where_the_robot_file_wants_it():
    rig = Rig(core_config(on_timeout=lib.STOP_COAST))
    rig.moving()
    rig.hold.add("command")
    rig.ticks(0.31)
    assert_rest(rig, enabled=0)
    assert rig.shown.armed == 0
    rig.hold.clear()
    rig.drive(0.0)
    assert rig.tick().armed == 0


def test_a_coasting_base_may_be_armed_before_its_first_command():
    rig = Rig(core_config(on_timeout=lib.STOP_COAST))
    rig.hold.add("command")
    rig.arm()
    rig.ticks(0.5)
    assert rig.shown.armed == 1


@pytest.mark.parametrize("ahead_ms", [11, 1000, 10**12])
def test_a_command_from_the_future_is_stale(ahead_ms):
    rig = Rig()
    rig.moving()
    rig.hold.add("command")
    rig.input.command.stamp_ns = rig.input.now_ns + TICK_NS + ahead_ms * 1_000_000
    rig.input.command.expires_ns = 2**62
    assert rig.tick().reasons & lib.REASON_COMMAND_STALE


def test_a_command_a_little_ahead_is_fresh():
    rig = Rig()
    rig.moving()
    rig.hold.add("command")
    rig.input.command.stamp_ns = rig.input.now_ns + TICK_NS + 9_000_000
    shown = rig.tick()
    assert not shown.reasons & lib.REASON_COMMAND_STALE
    assert shown.command_age_s == 0.0


def test_the_end_of_the_lease_ends_the_command():
    rig = Rig()
    rig.moving()
    rig.hold.add("command")
    rig.input.command.stamp_ns = rig.input.now_ns
    rig.input.command.expires_ns = rig.input.now_ns + 2 * TICK_NS
    rig.ticks(0.002)
    assert not rig.shown.reasons & lib.REASON_COMMAND_STALE
    assert rig.tick().reasons & lib.REASON_COMMAND_STALE


@pytest.mark.parametrize("broken", NOT_NUMBERS)
@pytest.mark.parametrize("axis", ["linear_m_s", "angular_rad_s"])
def test_a_command_that_is_no_number_ramps_to_rest_and_never_to_full_reverse(axis, broken):
    rig = Rig()
    rig.moving(0.5, 0.2)
    setattr(rig.input.command, axis, broken)
    before = rig.shown.setpoint_linear_m_s
    rig.tick()
    assert rig.shown.reasons & lib.REASON_COMMAND_NOT_FINITE
    for _ in range(2000):
        after = rig.tick().setpoint_linear_m_s
        assert 0.0 <= after <= before
        before = after
    assert_rest(rig, enabled=1)
    assert rig.shown.wanted_linear_m_s == 0.0


def test_a_set_point_smaller_than_any_motor_can_show_is_zero():
    rig = Rig()
    rig.arm()
    rig.drive(5e-324, -1e-200)
    rig.ticks(0.01)
    assert_rest(rig, enabled=1)


# --------------------------------------------------------------------------------------------- stop
@pytest.mark.parametrize("action", ["STOP_RAMP", "STOP_BRAKE", "STOP_HOLD", "STOP_COAST"])
def test_stop_brings_every_wheel_to_zero(action):
    rig = Rig(core_config(4, on_timeout=getattr(lib, action)))
    rig.moving(0.4, 0.6)
    assert len(set(rig.speeds)) == 2
    rig.input.control.stop = 1
    rig.tick()
    assert rig.shown.reasons & lib.REASON_STOP_REQUESTED
    assert_at_rest_after_ramp(rig)
    stays = action != "STOP_COAST"
    assert (rig.shown.armed, rig.out.enabled) == (stays, stays)
    rig.input.control.stop = 0
    rig.ticks(0.05)
    assert (rig.speeds[0] != 0.0) == stays


def test_limits_given_at_run_time_bind_at_once_also_where_none_had_been_set():
    free = {"velocity_u_s": 1e6, "acceleration_u_s2": 1e6, "deceleration_u_s2": 1e6}
    free["jerk_u_s3"] = math.inf
    rig = Rig(core_config(limits={axis: dict(free) for axis in ("linear", "angular", "lateral")}))
    rig.moving(1.0)
    rig.input.control.limits.linear = tuple((free | {"velocity_u_s": 0.25}).values())
    rig.tick()
    assert rig.shown.setpoint_linear_m_s == 0.25
    assert rig.shown.reasons & lib.REASON_LINEAR_VELOCITY


@pytest.mark.parametrize("broken", [*NOT_NUMBERS, 0.0, -1.0])
@pytest.mark.parametrize("field", ["velocity_u_s", "acceleration_u_s2", "deceleration_u_s2"])
@pytest.mark.parametrize("axis", ["linear", "angular"])
def test_limits_with_a_bad_one_among_them_are_refused_as_a_group(axis, field, broken):
    rig = Rig()
    rig.tick()
    limits = rig.input.control.limits
    limits.linear.velocity_u_s = limits.angular.velocity_u_s = 0.1
    setattr(getattr(limits, axis), field, broken)
    rig.tick()
    assert rig.state.limits.linear.velocity_u_s == 1.0
    assert rig.state.limits.angular.velocity_u_s == 2.0


def test_a_lowered_limit_brings_a_fast_base_down_by_braking():
    rig = Rig()
    rig.moving(1.0)
    rig.input.control.limits.linear.velocity_u_s = 0.4
    before = 1.0
    for _ in range(2000):
        after = rig.tick().setpoint_linear_m_s
        assert before - 1.5 * 0.001 * 1.000001 <= after <= before
        before = after
    assert before == 0.4


def test_feedback_is_stale_joint_by_joint():
    rig = Rig(core_config(4))
    rig.tick()
    for _ in range(300):
        rig.hold.add("feedback")
        for j in (0, 1, 3):
            rig.feedback[j].stamp_ns = rig.input.now_ns + TICK_NS
        rig.tick()
    assert [rig.shown.joint[j].stale for j in range(4)] == [0, 0, 1, 0]
    assert rig.shown.joint[2].feedback_age_s == pytest.approx(0.3)
    assert rig.shown.odometry_degraded == 1


def test_a_joint_that_was_never_received_is_infinitely_old():
    rig = Rig()
    no_feedback(rig)
    rig.tick()
    assert math.isinf(rig.shown.joint[0].feedback_age_s)
    assert math.isnan(rig.shown.joint[0].velocity_rad_s)
    assert rig.shown.joint[0].stale == 1


def test_ages_grow_between_samples():
    rig = Rig()
    rig.tick()
    rig.hold.add("feedback")
    rig.ticks(0.1)
    assert rig.shown.joint[0].feedback_age_s == pytest.approx(0.1)
    assert rig.shown.joint[0].stale == 0


def test_covariance_grows_while_a_moving_base_is_not_received():
    rig = Rig()
    rig.moving(0.5)
    before = list(rig.shown.pose_covariance)
    rig.hold.add("feedback")
    rig.ticks(0.6)
    after = list(rig.shown.pose_covariance)
    assert math.sqrt(after[0]) > math.sqrt(before[0]) + 0.05
    assert after[5] > before[5]
    rig.ticks(2.0)
    at_rest = list(rig.shown.pose_covariance)
    rig.ticks(1.0)
    assert list(rig.shown.pose_covariance) == at_rest, "a base at rest does not drift"


def test_a_changed_odometry_reset_count_sets_the_pose_to_the_origin():
    rig = Rig()
    rig.moving(0.5, 0.3)
    assert rig.shown.x_m > 0.0
    rig.hold.add("feedback")
    rig.input.control.odometry_reset_count = 7
    rig.tick()
    assert (rig.shown.x_m, rig.shown.y_m, rig.shown.heading_rad) == (0.0, 0.0, 0.0)
    assert rig.shown.odometry_epoch == 1
    assert rig.shown.distance_m > 0.0


def test_odometry_follows_what_the_wheels_did():
    rig = Rig()
    rig.moving(0.5)
    rig.drive(0.0)
    rig.ticks(1.5)
    travelled = rig.position_rad[0] * 0.1
    assert rig.shown.x_m == pytest.approx(travelled, abs=0.001)
    assert rig.shown.distance_m == pytest.approx(travelled, abs=0.001)
    assert rig.shown.at_rest == 1


@pytest.mark.parametrize("name", ["current_a", "voltage_v", "temperature_c"])
@pytest.mark.parametrize(
    ("reported", "shown"), [(1.5, 1.5), (math.nan, None), (math.inf, None), (-math.inf, None)]
)
def test_measures_pass_through_and_what_no_sensor_measures_is_nan(name, reported, shown):
    rig = Rig()
    setattr(rig.feedback[0], name, reported)
    rig.tick()
    value = getattr(rig.shown.joint[0], name)
    assert math.isnan(value) if shown is None else value == shown


def test_the_daemons_words_are_passed_on():
    rig = Rig()
    rig.input.control.machine_state = 4
    rig.input.control.owner = 9
    rig.tick()
    assert (rig.shown.machine_state, rig.shown.owner, rig.shown.tick) == (4, 9, 1)


def replay(seed_speeds: list[tuple[float, float]]) -> list[bytes]:
    rig = Rig(core_config(4))
    ffi.memmove(rig.out, b"\xaa" * ffi.sizeof("setpoints"), ffi.sizeof("setpoints"))
    ffi.memmove(rig.shown, b"\xaa" * ffi.sizeof("robot_state"), ffi.sizeof("robot_state"))
    rig.arm()
    record = []
    for linear, angular in seed_speeds:
        rig.drive(linear, angular)
        for _ in range(20):
            rig.tick()
            record.append(bytes(ffi.buffer(rig.out)) + bytes(ffi.buffer(rig.shown)))
    return record


ANY = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(ANY, ANY), min_size=1, max_size=5))
def test_the_same_input_gives_the_same_bytes_again(speeds):
    assert replay(speeds) == replay(speeds)


def test_what_was_in_the_outputs_before_does_not_stay():
    clean, dirty = Rig(), Rig()
    ffi.memmove(dirty.out, b"\xff" * ffi.sizeof("setpoints"), ffi.sizeof("setpoints"))
    ffi.memmove(dirty.shown, b"\xff" * ffi.sizeof("robot_state"), ffi.sizeof("robot_state"))
    for rig in (clean, dirty):
        rig.hold.add("feedback")
        rig.tick()
    assert bytes(ffi.buffer(clean.out)) == bytes(ffi.buffer(dirty.out))
    assert bytes(ffi.buffer(clean.shown)) == bytes(ffi.buffer(dirty.shown))


def numbers_of(shown: Any) -> list[float]:
    names = "dt_s wanted_linear_m_s wanted_angular_rad_s setpoint_linear_m_s x_m y_m heading_rad"
    names += " setpoint_angular_rad_s saturation distance_m turned_rad linear_m_s angular_rad_s"
    found = [getattr(shown, name) for name in names.split()]
    found += [*shown.pose_covariance, *shown.twist_covariance]
    for j in range(shown.joint_count):
        joint = shown.joint[j]
        found += [joint.position_rad, joint.setpoint_rad_s, joint.duty]
    return found


def fill(rig: Rig, noise: bytes) -> None:
    """Any bytes at all as input, but for the words that let the core arm."""
    ffi.memmove(rig.input, noise, ffi.sizeof("core_input"))


@given(st.integers(0, 2**32), ANY)
def test_no_input_whatsoever_gives_more_than_finite_numbers_or_moves_an_unarmed_base(seed, dt):
    random = Random(seed)
    rig = Rig(core_config(3, joint=[joint_config(side) for side in (-1.0, 1.0, 1.0)]))
    special = [math.nan, math.inf, -math.inf, 5e-324, 1e308, -1e308, 0.0]
    for _ in range(30):
        words = [
            struct.pack("d", random.choice(special))
            if random.random() < 0.3
            else random.randbytes(8)
            for _ in range(ffi.sizeof("core_input") // 8)
        ]
        fill(rig, b"".join(words))
        lib.core_step(rig.state, rig.input, dt, rig.out, rig.shown)
        assert all(math.isfinite(value) for value in numbers_of(rig.shown))
        assert rig.shown.armed == 1 or rig.shown.enabled == 1 or not any(rig.speeds)
        assert all(abs(speed) <= 15.0 for speed in rig.speeds)


@pytest.mark.parametrize("counter", ["odometry_reset_count", "reset_count"])
def test_a_word_of_the_daemon_while_driving_does_not_touch_the_speed(counter):
    rig = Rig()
    rig.moving(0.5)
    setattr(rig.input.control, counter, 3)
    rig.tick()
    assert rig.shown.setpoint_linear_m_s == 0.5
    assert rig.shown.armed == 1


def test_a_command_that_comes_with_arming_late_is_obeyed_in_its_own_tick():
    rig = Rig()
    rig.hold.add("command")
    rig.arm()
    rig.hold.clear()
    rig.drive(0.5)
    assert rig.tick().setpoint_linear_m_s > 0.0
