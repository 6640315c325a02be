# SPDX-License-Identifier: Apache-2.0
"""The reference sketch on every supported chip: what it does to the pins for each frame."""

import shutil
import struct
from dataclasses import dataclass

import pytest
from sketch_peer import STANDARDS, Sketch, compiled

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler (g++)")


@dataclass(frozen=True)
class Pins:
    pwm: tuple[int, int]
    in1: tuple[int, int]
    in2: tuple[int, int]
    a: tuple[int, int]
    b: tuple[int, int]
    standby: int


PINS = {
    "ESP32": Pins((25, 33), (26, 32), (27, 14), (18, 21), (19, 22), 4),
    "AVR": Pins((5, 6), (22, 24), (23, 25), (2, 18), (3, 19), 26),
    "RP2040": Pins((2, 4), (6, 8), (7, 9), (10, 12), (11, 13), 14),
}


@pytest.fixture(scope="module", params=sorted(STANDARDS))
def built(request, tmp_path_factory):
    return request.param, compiled(tmp_path_factory.mktemp("sketch"), request.param)


@pytest.fixture
def pins(built):
    return PINS[built[0]]


@pytest.fixture
def fresh(built):
    """The sketch before its setup() has run."""
    sketch = Sketch(built[1])
    yield sketch
    sketch.close()


@pytest.fixture
def sketch(fresh):
    fresh.do("setup")
    return fresh


def resting(sketch, pins):
    return not any(sketch.pwm[pin] for pin in pins.pwm)


def reported(sketch):
    """Return the status, and for each motor its count and its velocity in mrad/s."""
    payload = sketch.feedback[-1]
    return payload[0], [struct.unpack_from("<ii", payload, 16 + 10 * motor) for motor in (0, 1)]


def test_the_bridge_gets_power_last_and_only_when_its_watchdog_runs(sketch, pins):
    assert sketch.watchdog_ms == 250
    assert sketch.writes.index("watchdog 250") < sketch.writes.index(f"level {pins.standby} 1")
    assert sketch.writes[-1] == f"level {pins.standby} 1"
    assert resting(sketch, pins)


def test_a_chip_whose_watchdog_does_not_start_never_gives_power(fresh, built, pins):
    if built[0] != "ESP32":
        pytest.skip("only the ESP32's watchdog can refuse")
    fresh.do("broken")
    fresh.do("setup")
    fresh.run(0.1, 0, 0)
    assert fresh.levels[pins.standby] == 0


def test_nothing_turns_before_it_is_enabled_at_zero(sketch, pins):
    sketch.run(0.05, 3000, 3000, control=0)
    assert resting(sketch, pins)
    sketch.run(0.05, 3000, 3000)
    assert resting(sketch, pins)


def test_set_points_turn_each_motor_in_its_own_direction(sketch, pins):
    sketch.arm()
    sketch.run(0.03, 4200, -4200)
    assert [sketch.levels[pin] for pin in (*pins.in1, *pins.in2)] == [1, 0, 0, 1]
    # duty: 0.2 for the speed, 0.126 for the error in speed, a little for its sum over 30 ms
    assert [sketch.pwm[pin] for pin in pins.pwm] == [pytest.approx(0.36, abs=0.04)] * 2
    sketch.run(0.03, 10**9, 0)
    assert sketch.pwm[pins.pwm[0]] == 1.0


def test_the_old_duty_never_meets_the_new_direction(sketch, pins):
    sketch.arm()
    sketch.run(0.03, 4200, 4200)
    first = len(sketch.writes)
    sketch.run(0.03, -4200, 4200)
    rows = sketch.writes[first:]
    turned = rows.index(f"level {pins.in1[0]} 0")
    before = [row for row in rows[:turned] if row.startswith(f"pwm {pins.pwm[0]} ")]
    assert float(before[-1].split()[2]) == 0.0
    assert sketch.levels[pins.in2[0]] == 1
    assert sketch.pwm[pins.pwm[0]] > 0.1


def test_silence_brakes_until_it_is_enabled_again(sketch, pins):
    sketch.arm()
    sketch.run(0.03, 4200, 4200)
    sketch.run(0.12)
    brake = [sketch.levels[pin] for pin in (*pins.in1, *pins.in2)]
    assert (brake, sketch.pwm[pins.pwm[0]]) == ([1, 1, 1, 1], 1.0)
    status, _ = reported(sketch)
    assert status & 1 == 0
    assert status & 4 == 4
    sketch.run(0.03, 4200, 4200)
    assert [sketch.levels[pin] for pin in (*pins.in1, *pins.in2)] == [1, 1, 1, 1]
    sketch.run(0.03, 0, 0, control=0)
    assert resting(sketch, pins)


def test_edges_are_counted_in_both_directions_and_sent(sketch, pins):
    sketch.turn(pins.a[0], pins.b[0], 9)
    sketch.turn(pins.a[1], pins.b[1], -5)
    sketch.run(0.02, 0, 0, control=8)
    _, motors = reported(sketch)
    assert [count for count, _ in motors] == [9, -5]
    sketch.run(0.1, 0, 0, control=8)
    assert reported(sketch)[1] == [(9, 0), (-5, 0)]


def test_the_level_at_which_an_encoder_starts_is_not_counted_as_an_edge(fresh, pins):
    fresh.do(f"level {pins.a[0]} 1")
    fresh.do("setup")
    fresh.do(f"level {pins.b[0]} 1")
    fresh.run(0.02, 0, 0, control=8)
    assert reported(fresh)[1][0][0] == 1


def test_speed_is_measured_and_regulated_to_the_set_point(sketch, pins):
    sketch.arm()
    sketch.run(0.03, 4200, 4200)
    missing = sketch.pwm[pins.pwm[0]]
    sketch.turn(pins.a[0], pins.b[0], 8)
    sketch.run(0.005, 4200, 4200)
    # 8 of 1320 edges in 5 ms are 7.6 rad/s: faster than the set-point
    assert sketch.pwm[pins.pwm[0]] < missing - 0.1
    assert sketch.pwm[pins.pwm[1]] == pytest.approx(missing, abs=0.02)


def test_a_chip_of_eight_bits_reads_a_count_while_no_edge_can_come(sketch, built):
    sketch.run(0.01)
    reads = [row for row in sketch.writes if row.endswith("masked")]
    controls = 2 if built[0] == "AVR" else 0
    assert reads == ["masked", "unmasked"] * 2 * controls


def test_the_watchdog_is_fed_once_a_loop_and_nowhere_else(sketch, pins):
    sketch.command(1, 0, 0)
    sketch.turn(pins.a[0], pins.b[0], 4)
    assert sketch.writes.count("fed") == 0
    sketch.run(0.02)
    assert sketch.writes.count("fed") == 20
    assert sketch.writes[-1] == "fed"


def test_a_port_without_room_is_not_waited_for(sketch):
    sketch.run(0.05, 0, 0)
    there = len(sketch.feedback)
    assert there > 2
    sketch.do("room 10")
    sketch.run(0.05, 0, 0)
    assert len(sketch.feedback) == there
