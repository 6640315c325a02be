# SPDX-License-Identifier: Apache-2.0
"""A simulated hub motor with ten-byte frames, whose bytes stand as in the maker's tables."""

import math

import pytest
from ddsm_rig import COUNTS, MODE, QUERY, SET, SPEED, hub_motor
from sim_bench import CHARACTER_S, Bench

from motord_hal.ddsm.codec import build_reply, build_request, pick, sealed


@pytest.fixture
def bench(tmp_path):
    with Bench(tmp_path, hub_motor()) as bench:
        yield bench


def request(bench, command, unit=1, **raw):
    named = {bench.profile.registers[name]: value for name, value in raw.items()}
    return build_request(unit, command, named)


def arm(bench):
    assert bench.exchange(request(bench, MODE, mode=SPEED), 0.02) == b""


def test_a_set_point_is_answered_by_ten_bytes_with_check_sum_at_the_wire_s_pace(bench):
    frame = request(bench, SET, speed_wanted=0)
    bench.send(frame)
    bench.go_on(0.001 + 19.5 * CHARACTER_S)
    assert bench.line.wire.bytes_sent == 9
    bench.go_on(CHARACTER_S)
    assert bench.receive(10) == build_reply(1, SET, {})


def test_a_mode_is_set_and_not_answered(bench):
    assert not bench.drive.enabled(1)
    arm(bench)
    assert bench.drive.enabled(1)
    assert bench.line.counters.unanswered == 0
    assert bench.line.counters.bad_crc == 0


def test_an_armed_motor_follows_its_set_point_and_reports_its_speed(bench):
    arm(bench)
    bench.exchange(request(bench, SET, speed_wanted=60))
    bench.go_on(0.6)
    reply = bench.exchange(request(bench, SET, speed_wanted=60))
    registers = bench.profile.registers
    assert sealed(reply)
    assert pick(reply, registers["speed"]) == pytest.approx(60, abs=2)
    turned = bench.wheel().position_rad / (2.0 * math.pi) * COUNTS
    assert 0 < pick(reply, registers["position"]) <= turned


def test_a_query_commands_nothing(bench):
    arm(bench)
    bench.exchange(request(bench, SET, speed_wanted=60))
    sent = bench.exchange(request(bench, QUERY))
    assert pick(sent, bench.profile.registers["supply"]) == pytest.approx(24, abs=1)
    assert bench.drive.registers.stored("speed_wanted") == 60


def test_a_disarmed_motor_is_moved_by_no_set_point(bench):
    bench.exchange(request(bench, SET, speed_wanted=60))
    bench.go_on(0.5)
    assert bench.rig.plant.at_rest


def test_a_speed_out_of_range_changes_nothing(bench):
    bench.exchange(request(bench, SET, speed_wanted=20))
    assert sealed(bench.exchange(request(bench, SET, speed_wanted=331)))
    assert bench.drive.registers.stored("speed_wanted") == 20


@pytest.mark.parametrize("place", range(10))
def test_a_broken_request_is_met_with_silence(bench, place):
    broken = bytearray(request(bench, SET, speed_wanted=60))
    broken[place] ^= 0x10
    assert bench.exchange(bytes(broken)) == b""
    assert bench.drive.stats.requests == 0


def test_an_unknown_command_and_an_absent_unit_are_met_with_silence(bench):
    assert bench.exchange(build_request(1, 0x33, {})) == b""
    assert bench.exchange(request(bench, SET, unit=9)) == b""
    assert bench.line.counters.unanswered == 2


def test_its_faults_are_those_of_its_frames(bench):
    bench.rig.inject("wrong-unit:nth=2")
    good, foreign = (bench.exchange(request(bench, SET)) for _ in range(2))
    assert sealed(foreign)
    assert foreign[0] != good[0]
    assert foreign[1:9] == good[1:9]
    bench.rig.script.clear()
    bench.rig.inject("exception")
    assert bench.exchange(request(bench, SET)) == b""
