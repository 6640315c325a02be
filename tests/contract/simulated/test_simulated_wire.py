# SPDX-License-Identifier: Apache-2.0
"""The simulator's side of the wire, byte by byte, on a real pty; the test advances the clock."""

import os

import pytest
from sim_bench import CHARACTER_S, Bench

from motord_hal.modbus.codec import (
    Function,
    Request,
    build_exception,
    build_reply,
    build_request,
    seal,
    sealed,
    silent_interval_s,
)
from motord_hal.sim.fault_kinds import FaultError
from motord_hal.sim.rs485.line import TURNAROUND_PART

POSITIONS = Request(1, Function.READ_HOLDING, 0x20A7, 4)
FRAME = build_request(POSITIONS)
REPLY = build_reply(POSITIONS, (0, 0, 0, 0))
ENABLE = build_request(Request(0, Function.WRITE_SINGLE, 0x200E, values=(8,)))


@pytest.fixture
def bench(tmp_path):
    with Bench(tmp_path) as bench:
        yield bench


def test_a_reply_takes_the_time_that_the_wire_and_the_drive_take(bench):
    turnaround_s = TURNAROUND_PART * bench.profile.turnaround_s
    begins_s = bench.now_s + len(FRAME) * CHARACTER_S + turnaround_s
    bench.send(FRAME)
    bench.go_on(begins_s - bench.now_s)
    assert bench.line.wire.bytes_sent == 0
    for _ in range(40):
        bench.go_on(0.0002)
        passed = int((bench.now_s - begins_s) / CHARACTER_S + 0.001)
        assert bench.line.wire.bytes_sent <= min(passed, len(REPLY))
    assert bench.line.wire.bytes_sent == len(REPLY)
    assert bench.receive(len(REPLY)) == REPLY


def test_a_request_in_pieces_is_answered_as_a_whole(bench):
    bench.send(FRAME[:3])
    bench.go_on(3 * CHARACTER_S)
    assert bench.exchange(FRAME[3:]) == REPLY


def test_a_pause_inside_a_frame_ends_it(bench):
    assert bench.exchange(FRAME[:3]) == b""
    assert bench.exchange(FRAME[3:]) == b""
    assert bench.line.counters.bad_crc == 2
    assert bench.exchange(FRAME) == REPLY


def test_two_requests_without_silence_between_them_are_both_lost(bench):
    assert bench.exchange(FRAME + FRAME) == b""
    assert bench.line.counters.bad_crc == 1


@pytest.mark.parametrize("place", range(len(FRAME)))
def test_a_request_with_a_flipped_bit_is_met_with_silence(bench, place):
    broken = bytearray(FRAME)
    broken[place] ^= 0x10
    assert bench.exchange(bytes(broken)) == b""
    assert bench.line.counters.bad_crc == 1
    assert bench.drive.stats.requests == 0


def test_a_request_for_another_unit_is_met_with_silence(bench):
    assert bench.exchange(build_request(Request(9, Function.READ_HOLDING, 0x20A7, 4))) == b""
    assert bench.line.counters.unanswered == 1


def test_a_broadcast_is_carried_out_and_not_answered(bench):
    bench.run_steps(bench.profile.configure)
    assert bench.exchange(ENABLE) == b""
    assert bench.drive.enabled(1)
    refused = Request(0, Function.WRITE_SINGLE, 0x7777, values=(1,))
    assert bench.exchange(build_request(refused)) == b""
    assert bench.exchange(build_request(Request(0, Function.READ_HOLDING, 0x20A7, 1))) == b""


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (Request(1, Function.READ_INPUT, 0x20A7, 1), 1),
        (Request(1, Function.READ_HOLDING, 0x3000, 1), 2),
        (Request(1, Function.READ_HOLDING, 0x20AE, 2), 2),
        (Request(1, Function.READ_HOLDING, 0x20A1, 40), 3),
        (Request(1, Function.WRITE_SINGLE, 0x20A7, values=(1,)), 2),
        (Request(1, Function.WRITE_SINGLE, 0x2088, values=(3001,)), 3),
        (Request(1, Function.WRITE_MULTIPLE, 0x2088, values=(10, 3001)), 3),
        (Request(1, Function.WRITE_MULTIPLE, 0x2089, values=(10, 10)), 2),
    ],
)
def test_a_register_that_a_drive_does_not_have_is_refused_with_the_right_code(
    bench, request_, code
):
    assert bench.ask(request_).exception == code
    assert bench.drive.stats.exceptions == 1
    assert bench.read("target_velocity_1") == 0.0


def test_a_function_that_no_drive_has_is_refused(bench):
    assert bench.exchange(seal(b"\x01\x2b\x0e\x01\x00")) == build_exception(1, 0x2B, 1)


def test_a_request_that_comes_too_early_is_answered_and_counted(bench):
    silent_s = silent_interval_s(115200, 10)
    exchange_s = 0.0
    bench.exchange(FRAME)
    assert bench.drive.stats.gap_violations == 0
    bench.send(FRAME)
    while bench.line.wire.bytes_sent < 2 * len(REPLY):
        bench.go_on(0.0001)
        exchange_s += 0.0001
    bench.go_on(0.8 * silent_s)
    bench.send(FRAME)
    bench.go_on(exchange_s + 1.1 * silent_s)
    assert bench.drive.stats.gap_violations == 1
    bench.send(FRAME)
    bench.go_on(0.05)
    assert bench.drive.stats.gap_violations == 1
    assert bench.receive(3 * len(REPLY)) == 3 * REPLY


# ------------------------------------------------------------------------------------------- faults
@pytest.mark.parametrize(
    ("fault", "seen"),
    [
        ("drop", b""),
        ("tear:after_bytes=4", REPLY[:4]),
        ("glitch", b"\x00" + REPLY),
        ("exception:code=6", build_exception(1, 3, 6)),
        ("silence:for_s=10", b""),
    ],
)
def test_a_fault_is_seen_on_the_wire(tmp_path, fault, seen):
    with Bench(tmp_path, faults=(fault,)) as bench:
        assert bench.exchange(FRAME) == seen
        bench.rig.script.clear()
        assert bench.exchange(FRAME) == REPLY


@pytest.mark.parametrize("fault", ["drop:unit=2", "silence:unit=2,for_s=10"])
def test_a_fault_of_one_unit_leaves_its_neighbour_alone(tmp_path, fault):
    requests = [Request(unit, Function.READ_HOLDING, 0x0100, 1) for unit in (1, 2)]
    with Bench(tmp_path, "duty-register", faults=(fault,)) as bench:
        assert bench.exchange(build_request(requests[0])) == build_reply(requests[0], (0,))
        assert bench.exchange(build_request(requests[1])) == b""


def test_a_corrupt_reply_and_one_of_a_wrong_unit_are_seen_on_the_wire(tmp_path):
    with Bench(tmp_path, faults=("corrupt:nth=2", "wrong-unit:nth=3")) as bench:
        good, corrupt, foreign = (bench.exchange(FRAME) for _ in range(3))
    assert good == REPLY
    assert len(corrupt) == len(REPLY)
    assert not sealed(corrupt)
    assert sealed(foreign)
    assert foreign[0] != REPLY[0]


def test_a_delayed_reply_comes_later_by_its_delay(tmp_path):
    with Bench(tmp_path, faults=("delay:ms=40",)) as bench:
        assert bench.exchange(FRAME, 0.040) == b""
        bench.go_on(0.010)
        assert bench.receive(len(REPLY)) == REPLY


def test_a_late_reply_meets_the_next_request(tmp_path):
    with Bench(tmp_path, faults=("late:nth=2",)) as bench:
        velocities = Request(1, Function.READ_HOLDING, 0x20AB, 2)
        assert bench.exchange(FRAME) == REPLY
        assert bench.exchange(FRAME) == b""
        both = bench.exchange(build_request(velocities))
        assert both == REPLY + build_reply(velocities, (0, 0))


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    faults = ("drop:p=0.2", "corrupt:p=0.2", "delay:ms=3,p=0.3", "wrong-unit:p=0.1")

    def talk(folder, seed):
        with Bench(tmp_path / folder, faults=faults, seed=seed) as bench:
            return [bench.exchange(FRAME) for _ in range(40)]

    assert talk("a", 7) == talk("b", 7)
    assert talk("c", 7) != talk("d", 8)


@pytest.mark.parametrize(
    ("fault", "says"),
    [("drop:unit=7", "no unit 7"), ("fault:bit=31", "no fault bit 31"), ("fault:code=3", "code 3")],
)
def test_a_fault_that_this_robot_cannot_have_is_refused(bench, fault, says):
    with pytest.raises(FaultError, match=says):
        bench.rig.inject(fault)
    assert bench.exchange(FRAME) == REPLY


# ----------------------------------------------------------------------------------------- plugging
def test_a_pulled_plug_is_a_hang_up_and_a_new_plug_a_new_port(bench):
    old = os.readlink(bench.link)
    keeper = os.open(os.ttyname(bench.fd), os.O_RDWR | os.O_NOCTTY)
    bench.rig.pull()
    assert os.read(bench.fd, 10) == b""
    assert not bench.link.is_symlink()
    bench.rig.pull()
    bench.go_on(0.1)
    bench.rig.plug()
    bench.rig.plug()
    assert os.readlink(bench.link) != old
    os.close(keeper)
    bench.hang_up()
    bench.open()
    assert bench.exchange(FRAME) == REPLY


def test_a_script_can_pull_and_plug(tmp_path):
    with Bench(tmp_path, faults=("unplug:at_s=1,for_s=0.5",)) as bench:
        bench.go_on(0.9)
        assert bench.link.is_symlink()
        bench.go_on(0.2)
        assert not bench.link.is_symlink()
        bench.go_on(0.5)
        assert bench.link.is_symlink()


def test_a_program_that_opens_the_port_after_another_gets_no_old_bytes(bench):
    bench.send(FRAME)
    bench.hang_up()
    bench.go_on(0.5)
    bench.open()
    assert bench.exchange(FRAME) == REPLY


def test_bytes_that_nothing_reads_are_lost_and_hurt_nothing(bench):
    for _ in range(3000):
        os.write(bench.fd, FRAME)
        bench.go_on(0.02, step_s=0.01)
    assert bench.rig.plant.at_rest
