# SPDX-License-Identifier: Apache-2.0
"""The real-time loop as the daemon runs it. Tests wait for conditions; nothing here is timed."""

import math
import os
import platform
import select
import subprocess

import pytest
from _motord_rt import ffi, lib
from tests.rt.small_base import (
    LIMITS,
    PATIENCE_S,
    arm,
    core_config,
    lease_of,
    report_wheels,
    settings,
    until,
)

from motord.api.commands import Refusal
from motord.realtime import loop as rt
from motord_hal.realtime.exchange import LINES_MAX, Exchange

LATENESS, STEP, COMMAND = rt.HistogramKind


def readable(loop: rt.Loop) -> bool:
    return bool(select.select([loop], [], [], PATIENCE_S)[0])


def fds() -> set[str]:
    return set(os.listdir("/proc/self/fd"))


def test_it_ticks_disarmed_and_at_zero(loop):
    first = loop.read_state()
    until(lambda: loop.read_state().tick >= first.tick + 20)
    state, status = loop.read_state(), loop.status()
    assert state.stamp_ns > first.stamp_ns
    assert not state.armed
    assert not state.enabled
    assert "not_armed" in state.reasons
    assert (state.setpoint_linear_m_s, state.setpoint_angular_rad_s) == (0.0, 0.0)
    assert status.running
    assert status.ticks >= state.tick
    assert status.tick_stamp_ns >= state.stamp_ns


def test_python_that_starts_processes_costs_the_thread_no_page_fault():
    with rt.Loop(core_config(), settings(lock_memory=True, hold_dma_latency=True)) as loop:
        for _ in range(20):
            subprocess.run(["true"], check=True, timeout=60)
        seen = loop.status().ticks + 600  # the loop counts page faults in every 256th tick
        until(lambda: loop.status().ticks > seen)
        status = loop.status()
        assert status.page_faults == 0
    assert loop.status().page_faults == 0


def test_late_ticks_are_recorded_on_request_only(loop):
    until(lambda: loop.status().ticks > 20)
    assert loop.take_late() == []
    loop.stop()
    with rt.Loop(core_config(), settings(late_from_ns=1)) as recording:
        until(lambda: recording.status().ticks > 20)
    late = recording.take_late()
    assert len(late) + recording.status().late_lost == recording.status().ticks
    assert [one.deadline_ns for one in late] == sorted({one.deadline_ns for one in late})
    assert all(min(one.stage_ns[1:]) >= 0 and one.stage_ns[2] > 0 for one in late)
    assert all(one.woken_ns < one.end_ns for one in late)
    assert all(0 <= one.cpu < os.cpu_count() for one in late)


def test_after_a_stop_in_motion_every_line_is_sent_zero_and_off(loop):
    lease = arm(loop)
    lease.send(0.5, 0.0)
    line = Exchange.of_loop()
    until(lambda: all(joint.velocity_rad_s > 0 for joint in line.take_setpoints(0).joints))
    assert line.take_setpoints(0).enabled
    loop.stop()
    for index in range(LINES_MAX):
        last = line.take_setpoints(index)
        assert not last.enabled
        assert [(j.velocity_rad_s, j.duty) for j in last.joints] == [(0.0, 0.0)] * 2
    state = loop.read_state()
    assert (state.armed, state.enabled, state.setpoint_linear_m_s) == (False, False, 0.0)
    assert [(j.setpoint_rad_s, j.duty) for j in state.joints] == [(0.0, 0.0)] * 2
    assert state.stamp_ns == last.stamp_ns
    assert not loop.status().running


def test_it_restarts_disarmed_and_without_its_old_commands():
    loop = rt.Loop(core_config(), settings())
    before = fds()
    for _ in range(3):
        loop.start()
        state = loop.read_state()
        assert not state.armed
        assert state.command_age_s == math.inf
        try:
            arm(loop).send(0.5, 0.0)
            until(lambda: loop.read_state().setpoint_linear_m_s > 0)
        finally:  # a loop that continues to run makes the next tests fail
            loop.stop()
        loop.stop()
    assert fds() == before


def test_a_loop_that_starts_again_does_not_arm_by_the_control_of_its_last_run():
    loop = rt.Loop(core_config(), settings())
    loop.start()
    try:
        loop.put_control(rt.Control(armed=True, stop=True, machine_state=5, limits=LIMITS))
        until(lambda: loop.read_state().machine_state == 5)
    finally:
        loop.stop()
    loop.start()
    try:
        report_wheels()
        lease_of(loop).send(0.0, 0.0)
        loop.beat()
        until(lambda: not set(loop.read_state().reasons) & {"command_stale"})
        seen = loop.read_state()
        assert (seen.machine_state, seen.armed) == (0, False)
        assert "stop_requested" not in seen.reasons
    finally:
        loop.stop()


def test_a_second_loop_in_the_process_is_refused_and_the_first_keeps_running(loop):
    with pytest.raises(RuntimeError, match="already"):
        rt.Loop(core_config(), settings()).start()
    seen = loop.status().ticks
    until(lambda: loop.status().ticks > seen)


def test_stopping_a_loop_that_does_not_run_is_an_error():
    assert lib.loop_stop() == -3
    assert lib.loop_histogram_clear() == -3
    with pytest.raises(OSError, match="No such process"):
        rt.Loop(core_config(), settings()).clear_histograms()
    with pytest.raises(ValueError, match="does not run"):
        rt.Loop(core_config(), settings()).fileno()


@pytest.mark.parametrize(
    "bad",
    [
        {"rate_hz": math.nan},
        {"rate_hz": math.inf},
        {"rate_hz": -1000.0},
        {"rate_hz": 9.0},
        {"rate_hz": 20001.0},
        {"priority": 100},
        {"priority": -1},
    ],
)
def test_settings_out_of_range_are_refused_and_leave_nothing_open(bad):
    loop = rt.Loop(core_config(), settings(notify_hz=0.0, **bad))
    before = fds()
    with pytest.raises(ValueError, match="refuses"):
        loop.start()
    assert fds() == before
    with rt.Loop(core_config(), settings()):
        pass


def test_a_cpu_number_out_of_range_is_refused():
    with pytest.raises(ValueError, match="cpu"):
        rt.Loop(core_config(), settings(cpu=(64,)))


def test_a_page_that_cannot_be_mapped_leaves_no_descriptor_open():
    core, config = ffi.new("core_config *", core_config()), ffi.new("loop_config *")
    config.rate_hz, config.event_fd, config.page_fd = 100, -1, 987654
    config.journal_fd = -1
    config.command_fd = -1
    before = fds()
    assert lib.loop_start(config, core) == -9
    assert fds() == before
    config.page_fd = -1
    assert lib.loop_start(config, core) == 0
    assert lib.loop_stop() == 0


def test_a_value_that_the_core_refuses_is_named():
    bad = core_config()
    bad["joint"][1]["wheel_radius_m"] = math.nan
    with pytest.raises(rt.ConfigRefused, match=r"joint\[1\]\.wheel_radius_m") as refused:
        rt.Loop(bad, settings())
    assert refused.value.field == "joint[1].wheel_radius_m"


@pytest.mark.parametrize("count", [0, 1, 3, 9])
def test_a_count_of_joints_that_is_not_the_number_of_joints_is_refused(count):
    bad = core_config()
    bad["joint_count"] = count
    with pytest.raises(rt.ConfigRefused, match="joint_count"):
        rt.Loop(bad, settings())


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 0.0, -1.0])
@pytest.mark.parametrize("axis", ["linear", "angular"])
def test_limits_that_are_not_finite_and_positive_are_a_problem(axis, value):
    bad = {**LIMITS, axis: {**LIMITS[axis], "velocity_u_s": value}}
    assert rt.limits_problem(bad) == f"{axis}.velocity_u_s"
    assert rt.limits_problem(LIMITS) is None


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "aarch64"), reason="no flush-to-zero on this machine"
)
def test_the_thread_treats_denormal_numbers_as_zero():
    config = core_config()
    for wheel in config["joint"]:
        wheel["counter_bits"] = 0
    with rt.Loop(config, settings()) as loop:

        def received(velocity_rad_s: float) -> bool:
            report_wheels(velocity_rad_s=velocity_rad_s)
            return loop.read_state().linear_m_s != 0

        until(lambda: received(1e-3))  # so that the feedback goes into the measured speed
        until(lambda: not received(1e-307))  # times the radius of 0.1 m it is a denormal number
        assert loop.read_state().joints[0].velocity_rad_s == 1e-307


def test_a_command_that_is_not_finite_moves_nothing(loop):
    lease = arm(loop)
    lease.send(math.nan, math.inf)
    until(lambda: loop.commands().refused[Refusal.NOT_FINITE] == 1)
    state = loop.read_state()
    assert (state.wanted_linear_m_s, state.wanted_angular_rad_s) == (0.0, 0.0)
    assert (state.setpoint_linear_m_s, state.setpoint_angular_rad_s) == (0.0, 0.0)


@pytest.mark.parametrize("stamp_ns", [-(2**63), -1, 0])
def test_a_stamp_from_before_the_clock_is_a_stale_command(loop, stamp_ns):
    lease_of(loop).send(0.5, 0.0, stamp_ns)
    seen = loop.status().ticks + 3
    until(lambda: loop.status().ticks > seen)
    assert "command_stale" in loop.read_state().reasons
    assert loop.percentiles(COMMAND).samples == 0


def test_the_event_is_written_periodically():
    with rt.Loop(core_config(), settings(notify_hz=100.0)) as loop:
        for _ in range(5):
            assert readable(loop)
            assert loop.drain() >= 1


def test_the_event_is_written_only_when_something_changes():
    with rt.Loop(core_config(), settings(notify_hz=0.0)) as loop:
        assert readable(loop)
        loop.drain()
        seen = loop.status().ticks + 50
        until(lambda: loop.status().ticks > seen)
        assert loop.drain() == 0
        report_wheels()
        lease_of(loop).send(0.0, 0.0)
        assert readable(loop)
        assert "command_stale" not in loop.read_state().reasons
        loop.drain()
        loop.put_control(rt.Control(estop=True, limits=LIMITS))
        assert readable(loop)
        assert loop.read_state().faults == ("estop",)


def test_each_command_is_counted_once_with_the_time_it_took(loop):
    lease = lease_of(loop)
    for sent in range(1, 6):
        lease.send(0.0, 0.0)
        until(lambda sent=sent: loop.percentiles(COMMAND).samples == sent)
    taken = loop.percentiles(COMMAND)
    assert 0 < taken.p50_ns <= taken.p99_ns <= taken.p99_9_ns <= taken.max_ns


def test_every_tick_is_in_both_histograms(loop):
    until(lambda: loop.status().ticks > 50)
    loop.stop()
    ticks = loop.status().ticks
    for kind in (LATENESS, STEP):
        spread = loop.percentiles(kind)
        assert spread.samples == ticks
        assert 0 < spread.p50_ns <= spread.p99_ns <= spread.p99_9_ns <= spread.max_ns
        buckets = loop.buckets(kind)
        assert sum(bucket.samples for bucket in buckets) == ticks
        assert all(bucket.low_ns < bucket.high_ns for bucket in buckets)
        assert buckets == sorted(buckets, key=lambda bucket: bucket.low_ns)
        assert buckets[-1].low_ns <= spread.max_ns < buckets[-1].high_ns


def test_a_cleared_histogram_begins_again(loop):
    def fewer_than_ticks() -> bool:
        ticks = loop.status().ticks
        return loop.percentiles(LATENESS).samples < ticks

    until(lambda: loop.status().ticks > 200)
    assert not fewer_than_ticks()
    loop.clear_histograms()
    until(fewer_than_ticks)


def test_an_unknown_histogram_is_refused():
    assert lib.loop_histogram_read(lib.HISTOGRAM_KINDS, ffi.new("histogram *")) == -22


def test_the_odometry_reset_and_the_machine_state_reach_the_core(loop):
    before = loop.read_state().odometry_epoch
    loop.put_control(rt.Control(odometry_reset_count=1, machine_state=3, limits=LIMITS))
    until(lambda: loop.read_state().odometry_epoch != before)
    state = loop.read_state()
    assert (state.machine_state, state.owner) == (3, 0)
