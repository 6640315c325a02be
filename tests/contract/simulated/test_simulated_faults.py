# SPDX-License-Identifier: Apache-2.0
"""Faults of a wire and of a drive, seen by a master on a pty whose clock the test advances."""

import dataclasses
import os
import termios

import pytest
from sim_bench import CHARACTER_S, Bench

from motord_hal.modbus.codec import (
    Function,
    Request,
    build_exception,
    build_reply,
    build_request,
    sealed,
)

POSITIONS = Request(1, Function.READ_HOLDING, 0x20A7, 4)
FRAME = build_request(POSITIONS)
REPLY = build_reply(POSITIONS, (0, 0, 0, 0))
PARITY_BITS = termios.PARENB | termios.PARODD


def set_up(fd, speed, parity=0):
    modes = termios.tcgetattr(fd)
    modes[2] = modes[2] & ~PARITY_BITS | parity
    modes[4] = modes[5] = speed
    termios.tcsetattr(fd, termios.TCSANOW, modes)


# ---------------------------------------------------------------------------------------- the line
def test_an_adapter_that_echoes_returns_the_request_before_the_reply(tmp_path):
    with Bench(tmp_path, faults=("echo",)) as bench:
        bench.send(FRAME)
        bench.go_on(4.5 * CHARACTER_S)
        assert bench.line.wire.bytes_sent == 4
        bench.go_on(0.06)
        assert bench.receive(len(FRAME) + len(REPLY)) == FRAME + REPLY


def test_an_echo_does_not_count_as_a_request_sent_too_early(tmp_path):
    with Bench(tmp_path, faults=("echo",)) as bench:
        for _ in range(3):
            assert bench.exchange(FRAME) == FRAME + REPLY
        assert bench.line.counters.gap_violations == 0


def test_noise_breaks_requests_and_replies_and_counts_its_bits(tmp_path):
    with Bench(tmp_path, faults=("noise:ber=0.004",), seed=3) as bench:
        received = [bench.exchange(FRAME) for _ in range(60)]
        assert bench.line.counters.bits_hit > 10
        assert bench.line.counters.bad_crc > 5
        assert REPLY in received
        broken = [frame for frame in received if frame not in (REPLY, b"")]
        assert broken
        assert not any(sealed(frame) for frame in broken)
        bench.rig.script.clear()
        assert bench.exchange(FRAME) == REPLY


def test_babble_reaches_a_master_that_has_sent_nothing(tmp_path):
    with Bench(tmp_path, faults=("babble:hz=20,for_s=1",), seed=5) as bench:
        bench.go_on(1.2)
        assert bench.line.wire.bytes_sent > 5
        assert bench.receive(bench.line.wire.bytes_sent)
        assert bench.exchange(FRAME) == REPLY


@pytest.mark.parametrize("lost", [1, 3, len(REPLY) - 1])
def test_an_adapter_that_keeps_driving_swallows_the_beginning_of_the_reply(tmp_path, lost):
    stuck_ms = 1000 * (0.001 + (lost - 0.5) * CHARACTER_S)
    with Bench(tmp_path, faults=("turnaround:ms=1", f"stuck-de:ms={stuck_ms}")) as bench:
        assert bench.exchange(FRAME) == REPLY[lost:]


def test_an_adapter_that_drives_for_long_swallows_the_whole_reply(tmp_path):
    with Bench(tmp_path, faults=("stuck-de:ms=50,for_s=0.2",)) as bench:
        assert bench.exchange(FRAME) == b""
        bench.go_on(0.2)
        assert bench.exchange(FRAME) == REPLY


def test_a_turnaround_is_as_long_as_the_script_specifies(tmp_path):
    with Bench(tmp_path, faults=("turnaround:ms=7",)) as bench:
        bench.send(FRAME)
        bench.go_on((len(FRAME) + len(REPLY) - 0.5) * CHARACTER_S + 0.007)
        assert bench.line.wire.bytes_sent == len(REPLY) - 1
        bench.go_on(CHARACTER_S)
        assert bench.receive(len(REPLY)) == REPLY


def test_a_turnaround_spreads_from_its_least_to_its_most(tmp_path):
    least_s, most_s, step_s = 0.002, 0.012, 0.0002
    with Bench(tmp_path, faults=("turnaround:ms=2,spread_ms=10",), seed=9) as bench:
        took = []
        for number in range(1, 41):
            bench.send(FRAME)
            began_s = bench.now_s
            while bench.line.wire.bytes_sent < number * len(REPLY):
                bench.go_on(step_s)
            took.append(bench.now_s - began_s - (len(FRAME) + len(REPLY)) * CHARACTER_S)
            bench.go_on(0.005)
            assert bench.receive(len(REPLY)) == REPLY
    assert least_s - step_s <= min(took) < least_s + 0.002
    assert most_s - 0.002 < max(took) <= most_s + 2 * step_s


# ---------------------------------------------------------------------------------- baud and parity
@pytest.mark.parametrize(
    ("speed", "parity", "received"),
    [
        (termios.B115200, 0, REPLY),
        (termios.B38400, 0, REPLY),
        (termios.B9600, 0, b""),
        (termios.B230400, 0, b""),
        (termios.B115200, PARITY_BITS, b""),
    ],
)
def test_a_drive_receives_only_from_a_master_with_its_own_settings(
    tmp_path, speed, parity, received
):
    with Bench(tmp_path) as bench:
        set_up(bench.fd, speed, parity)
        assert bench.exchange(FRAME, 0.1) == received
        assert bench.line.counters.bad_crc == (received == b"")
        assert bench.drive.stats.requests == (received == REPLY)


def test_a_drive_at_another_baud_rate_answers_only_there_and_at_its_pace(tmp_path):
    with Bench(tmp_path, faults=("wrong-baud:baudrate=9600", "turnaround:ms=0")) as bench:
        set_up(bench.fd, termios.B115200)
        assert bench.exchange(FRAME) == b""
        set_up(bench.fd, termios.B9600)
        both_s = (len(FRAME) + len(REPLY)) * 10 / 9600
        bench.send(FRAME)
        bench.go_on(both_s - 0.0005)
        assert bench.line.wire.bytes_sent == len(REPLY) - 1
        bench.go_on(0.001)
        assert bench.receive(len(REPLY)) == REPLY


def test_a_drive_of_another_parity_is_noise_to_the_line(tmp_path):
    with Bench(tmp_path, faults=("wrong-parity:for_s=0.05",)) as bench:
        assert bench.exchange(FRAME) == b""
        assert bench.line.counters.bad_crc == 1
        assert bench.exchange(FRAME) == REPLY


# --------------------------------------------------------------------------------------- the drives
SETTING, VALUE = "control_mode", 3
"""Register of a zlac8015d that only its set-up writes, and the value."""


def test_a_drive_is_unresponsive_while_it_stores_a_setting(tmp_path):
    with Bench(tmp_path, faults=("slow-flash:ms=100",)) as bench:
        assert bench.write(SETTING, VALUE) is None
        assert bench.exchange(FRAME, 0.02) == b""
        bench.go_on(0.1)
        assert bench.exchange(FRAME) == REPLY
        assert bench.drive.stats.flashed == 1


def test_a_busy_drive_refuses_while_it_stores_a_setting(tmp_path):
    with Bench(tmp_path, faults=("slow-flash:ms=100,busy=1",)) as bench:
        assert bench.write(SETTING, VALUE) is None
        assert bench.exchange(FRAME, 0.02) == build_exception(1, Function.READ_HOLDING, 6)
        bench.go_on(0.1)
        assert bench.exchange(FRAME) == REPLY


def test_a_set_point_is_not_stored_and_takes_no_time(tmp_path):
    with Bench(tmp_path, faults=("slow-flash:ms=100",)) as bench:
        assert bench.write("target_velocity_1", 0) is None
        assert bench.exchange(FRAME) == REPLY


@pytest.mark.parametrize("keep", [0, 1])
def test_a_brown_out_disables_and_may_keep_the_counter(tmp_path, keep):
    with Bench(tmp_path, seed=1) as bench:
        bench.run_steps(bench.profile.configure)
        bench.run_steps(bench.profile.arm)
        assert bench.drive.enabled(1)
        bench.write("target_velocity_1", 60)
        bench.go_on(0.3)
        moved = bench.read("position_1")
        assert moved != 0
        bench.rig.inject(f"brown-out:for_s=0.01,keep={keep}")
        bench.go_on(0.5)
        assert not bench.drive.enabled(1)
        assert bench.drive.stats.reboots == 1
        assert bench.read("target_velocity_1") == 0.0
        assert abs(bench.read("position_1")) >= abs(moved) if keep else True
        bench.go_on(3.0)
        stood = bench.read("position_1")
        bench.rig.inject(f"brown-out:for_s=0.01,keep={keep}")
        bench.go_on(0.1)
        assert bench.read("position_1") == (stood if keep else 0)


# --------------------------------------------------------------------------------- many, and truth
def test_thirty_two_drives_share_a_line(tmp_path):
    with Bench(tmp_path, "duty-register", units=32) as bench:
        for unit in range(1, 33):
            request = Request(unit, Function.READ_HOLDING, 0x0100, 1)
            assert bench.exchange(build_request(request)) == build_reply(request, (0,))
        absent = Request(33, Function.READ_HOLDING, 0x0100, 1)
        assert bench.exchange(build_request(absent)) == b""
        assert {drive.stats.requests for drive in bench.line.drives.values()} == {1}
        assert bench.rig.truth()["joints"].keys() == {"left", "right"}


def test_a_tagged_count_contains_its_unit_and_the_journal_the_values_sent(tmp_path):
    with Bench(tmp_path, tagged=True, faults=("corrupt:nth=2",)) as bench:
        good = bench.exchange(FRAME)
        spoiled = bench.exchange(FRAME)
        entries = bench.rig.journal("bus", 1, 0)
        assert [entry["number"] for entry in entries] == [0, 1]
        assert all(build_reply(POSITIONS, entry["words"]) == good for entry in entries)
        assert good != spoiled
        assert {entry["address"] for entry in entries} == {POSITIONS.address}
        stamps = [entry["monotonic_ns"] - bench.rig.began_ns for entry in entries]
        bench.rig.script.clear()
        assert 0 < stamps[0] < stamps[1] <= bench.now_s * 1e9
        assert bench.read("position_1") == 1 << 24
        assert bench.read("position_2") == (1 << 24) + (1 << 21)
        assert bench.rig.journal("bus", 1, 3)[0]["number"] == 3


def test_the_journal_of_a_plain_rig_stays_empty(tmp_path):
    with Bench(tmp_path) as bench:
        assert bench.exchange(FRAME) == REPLY
        assert bench.rig.journal("bus", 1, 0) == []


def test_function_23_writes_before_it_reads_and_is_refused_as_a_whole(tmp_path):
    with Bench(tmp_path) as bench:
        bench.drive.profile = dataclasses.replace(bench.profile, read_write_function=23)
        both = Request(1, Function.READ_WRITE, 0x2088, count=2, write_address=0x2088, values=(5, 7))
        assert bench.exchange(build_request(both)) == build_reply(both, (5, 7))
        unreadable = dataclasses.replace(both, address=0x7777, values=(1, 1))
        assert bench.exchange(build_request(unreadable)) == build_exception(1, 23, 2)
        unwritable = dataclasses.replace(both, write_address=0x20A7)
        assert bench.exchange(build_request(unwritable)) == build_exception(1, 23, 2)
        still = Request(1, Function.READ_HOLDING, 0x2088, 2)
        assert bench.exchange(build_request(still)) == build_reply(still, (5, 7))


def test_a_drive_whose_profile_has_no_function_23_refuses_it(tmp_path):
    with Bench(tmp_path) as bench:
        bench.drive.profile = dataclasses.replace(bench.profile, read_write_function=None)
        both = Request(1, Function.READ_WRITE, 0x2088, 2, 0x2088, (5, 7))
        assert bench.exchange(build_request(both)) == build_exception(1, 23, 1)


def test_a_master_that_hangs_up_clears_the_lateness_of_replies(tmp_path):
    with Bench(tmp_path) as bench:
        assert bench.line.stats()["reply_lateness_us"] == {}
        assert bench.exchange(FRAME) == REPLY
        late_us = bench.line.stats()["reply_lateness_us"]
        assert set(late_us) == {"p50", "p99", "max"}
        os.close(bench.fd)
        bench.fd = -1
        bench.go_on(0.1)
        bench.open()
        assert bench.exchange(FRAME) == REPLY
