# SPDX-License-Identifier: Apache-2.0
"""Motion of the simulated drives' motors, read over the wire; the test advances the clock."""

import math

import pytest
from sim_bench import Bench

from motord_hal.modbus.codec import Function, Request, build_request
from motord_hal.sim.plant import WheelModel

RPM = 2 * math.pi / 60


@pytest.fixture
def bench(tmp_path):
    with Bench(tmp_path) as bench:
        bench.run_steps(bench.profile.configure)
        yield bench


def arm(bench):
    bench.run_steps(bench.profile.arm)


def spin(bench, seconds=1.0):
    """Turn both wheels forward at 60 rpm, with requests often enough for the drive's watchdog."""
    velocities = (60, 0x10000 - 60)
    until_s = bench.now_s + seconds
    while bench.now_s < until_s:
        request = Request(1, Function.WRITE_MULTIPLE, 0x2088, values=velocities)
        assert bench.ask(request).exception is None


def test_a_drive_that_is_not_enabled_ignores_its_set_points(bench):
    spin(bench)
    assert bench.rig.plant.truth.moved_max_m_s == 0.0
    assert bench.read("control_word") != 8


def test_an_enabled_drive_turns_both_wheels_forward_and_reports_it(bench):
    arm(bench)
    assert bench.read("control_word") == 8
    spin(bench)
    for name in ("left", "right"):
        assert bench.wheel(name).velocity_rad_s == pytest.approx(60 * RPM, abs=0.1)
    assert bench.read("velocity_1") == pytest.approx(60 * RPM, abs=0.1)
    assert bench.read("velocity_2") == pytest.approx(-60 * RPM, abs=0.1)
    turned_rad = bench.read("position_1") / 4096 * 2 * math.pi
    assert turned_rad == pytest.approx(bench.wheel("left").position_rad, abs=0.5)
    assert bench.read("position_2") < 0 < bench.read("position_1")
    assert bench.read("current_1") > 0 > bench.read("current_2")
    assert bench.read("bus_voltage") < 36.0


def test_a_gear_lies_between_motor_and_wheel(tmp_path):
    with Bench(tmp_path, gear_ratio=10.0) as bench:
        bench.run_steps(bench.profile.configure)
        arm(bench)
        spin(bench)
        assert bench.wheel().velocity_rad_s == pytest.approx(6 * RPM, abs=0.02)
        assert bench.read("velocity_1") == pytest.approx(60 * RPM, abs=0.2)


def test_enabling_a_drive_with_an_old_set_point_moves_it(bench):
    spin(bench, 0.1)
    arm(bench)
    bench.go_on(0.5)
    assert bench.wheel().velocity_rad_s > 1.0


def test_a_disarmed_wheel_coasts_and_a_quick_stop_brakes_it(bench):
    seconds = {}
    for name in ("disarm", "quick_stop"):
        spin(bench, 0.1)
        arm(bench)
        spin(bench)
        bench.run_steps(getattr(bench.profile, name))
        start_s = bench.now_s
        assert not bench.drive.enabled(1)
        while not bench.rig.plant.at_rest:
            bench.go_on(0.01)
        seconds[name] = bench.now_s - start_s
    speed_rad_s = 60 * RPM
    assert seconds["quick_stop"] < speed_rad_s / WheelModel().deceleration_rad_s2 + 0.3
    assert seconds["disarm"] > 2 * seconds["quick_stop"]


def test_the_watchdog_stops_the_wheels_and_disables_the_drive(bench):
    assert bench.write("communication_timeout", 300) is None
    arm(bench)
    spin(bench)
    bench.go_on(0.2)
    assert bench.wheel().velocity_rad_s > 5.0
    bench.go_on(0.1 + 60 * RPM / WheelModel().deceleration_rad_s2 + 0.3)
    assert bench.rig.plant.at_rest
    assert bench.drive.stats.watchdog_bites == 1
    assert bench.read("control_word") != 8
    spin(bench)
    assert bench.rig.plant.at_rest


def test_requests_to_another_unit_and_broken_ones_do_not_feed_the_watchdog(bench):
    assert bench.write("communication_timeout", 300) is None
    arm(bench)
    spin(bench)
    for _ in range(20):
        bench.exchange(b"\x09\x03\x20\xa7\x00\x04\x00\x00")
    assert bench.drive.stats.watchdog_bites == 1
    assert bench.rig.plant.at_rest


def test_a_watchdog_of_zero_never_trips(bench):
    assert bench.write("communication_timeout", 0) is None
    arm(bench)
    spin(bench)
    bench.go_on(5.0, step_s=0.05)
    assert bench.wheel().velocity_rad_s == pytest.approx(60 * RPM, abs=0.1)


def test_a_drive_without_a_watchdog_may_be_given_one(tmp_path):
    rests = []
    for watchdog_s in (0.0, 0.3):
        with Bench(tmp_path / str(watchdog_s), "bld-305s", watchdog_s=watchdog_s) as bench:
            bench.run_steps(bench.profile.configure)
            assert bench.write("target_velocity", 100) is None
            assert bench.write("run_command", 1) is None
            bench.go_on(2.0, step_s=0.05)
            rests.append(bench.rig.plant.at_rest)
    assert rests == [False, True]


def test_a_set_point_that_needs_others_is_followed_when_one_request_carries_all(tmp_path):
    with Bench(tmp_path, "cs2rs") as bench:
        bench.run_steps(bench.profile.configure)
        arm(bench)
        for address, words in ((0x6203, (60,)), (0x6203, (60, 50, 50, 0, 0)), (0x6207, (0x10,))):
            request = Request(1, Function.WRITE_MULTIPLE, address, values=words)
            assert bench.ask(request).exception is None
        bench.go_on(0.2)
        assert bench.wheel().velocity_rad_s == 0.0
        request = Request(1, Function.WRITE_MULTIPLE, 0x6203, values=(60, 50, 50, 0, 0x10))
        assert bench.ask(request).exception is None
        bench.go_on(1.0)
        assert bench.wheel().velocity_rad_s == pytest.approx(60 * RPM, abs=0.1)


def test_a_direction_register_selects_the_direction(tmp_path):
    with Bench(tmp_path, "bld-305s") as bench:
        bench.run_steps(bench.profile.configure)
        assert bench.write("target_velocity", 100) is None
        directions = []
        for direction in (1, 2, 0):
            assert bench.write("run_command", direction) is None
            bench.go_on(1.0)
            directions.append(round(bench.wheel().velocity_rad_s / (100 * RPM), 2))
            assert bench.read("velocity") == pytest.approx(abs(directions[-1]) * 100 * RPM, abs=0.2)
    assert directions == [1.0, -1.0, 0.0]


def test_a_fault_takes_the_power_from_its_channel_until_it_is_cleared_and_armed_again(bench):
    assert bench.write("communication_timeout", 0) is None
    arm(bench)
    spin(bench)
    bench.rig.inject("fault:unit=1,channel=1,bit=2")
    bench.go_on(0.1)
    assert bench.read("fault_1") == 1 << 2
    assert bench.read("fault_2") == 0
    assert bench.wheel("left").torque_n_m == 0.0
    assert bench.read("control_word") != 8
    arm(bench)
    assert not bench.drive.enabled(1)
    bench.run_steps(bench.profile.clear_fault)
    assert bench.read("fault_1") == 0
    bench.go_on(1.0)
    assert bench.wheel("left").torque_n_m == 0.0
    arm(bench)
    assert bench.drive.enabled(1)


def test_a_numbered_fault_reads_as_its_number(tmp_path):
    with Bench(tmp_path, "bld-305s") as bench:
        bench.rig.inject("fault:unit=2,code=8")
        bench.go_on(0.1)
        assert bench.read("fault", unit=2) == 8
        assert bench.read("fault", unit=1) == 0
        bench.run_steps(bench.profile.clear_fault, unit=2)
        assert bench.read("fault", unit=2) == 0


def test_a_drive_that_reboots_is_silent_and_comes_back_disabled_with_its_defaults(bench):
    assert bench.write("communication_timeout", 400) is None
    arm(bench)
    spin(bench)
    bench.rig.inject("reboot:unit=1,for_s=1")
    bench.go_on(0.1)
    position = Request(1, Function.READ_HOLDING, 0x20A7, 2)
    assert bench.exchange(build_request(position)) == b""
    bench.go_on(3.0)
    default = bench.profile.registers["communication_timeout"].default
    assert bench.read("communication_timeout") == pytest.approx(default / 1000)
    assert bench.read("target_velocity_1") == 0.0
    assert bench.read("control_word") != 8
    assert not bench.drive.enabled(1)
    assert bench.rig.plant.at_rest
    assert bench.wheel().position_rad > 6.0
    counted = bench.read("position_1") / 4096 * 2 * math.pi
    assert counted < bench.wheel().position_rad / 2


def test_an_injected_fault_takes_effect_before_the_injection_returns(bench):
    """Otherwise the next request may reach a drive that still has its power."""
    arm(bench)
    assert bench.drive.enabled(1)
    bench.rig.inject("reboot:unit=1,for_s=1")
    assert not bench.drive.enabled(1)


def test_counters_near_their_wrap_wrap_within_a_quarter_turn_forward(tmp_path):
    with Bench(tmp_path, faults=("encoder-wrap",)) as bench:
        bench.run_steps(bench.profile.configure)
        arm(bench)
        before = [bench.read(f"position_{number}") for number in (1, 2)]
        assert before[0] > 2**31 - 2000
        assert before[1] < -(2**31) + 2000
        spin(bench, 1.0)
        bench.run_steps(bench.profile.quick_stop)
        bench.go_on(1.0)
        after = [bench.read(f"position_{number}") for number in (1, 2)]
    assert after[0] < 0 < after[1]
    turned = [(new - old) % 2**32 for new, old in zip(after, before, strict=True)]
    assert turned[0] == pytest.approx(2**32 - turned[1], abs=2)
    assert 1000 < turned[0] < 6000


def test_the_true_pose_follows_the_wheels(bench):
    arm(bench)
    spin(bench)
    truth = bench.rig.truth()
    assert truth["heading_rad"] == pytest.approx(0.0, abs=1e-9)
    assert truth["x_m"] == pytest.approx(0.1 * bench.wheel().position_rad)
    assert truth["joints"]["right"]["velocity_rad_s"] == pytest.approx(60 * RPM, abs=0.1)
    assert truth["joints"]["right"]["enabled"]
    assert not truth["at_rest"]
    assert truth["rest_since_s"] == 0.0
