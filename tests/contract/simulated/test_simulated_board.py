# SPDX-License-Identifier: Apache-2.0
"""A simulated board of one's own: its frames carry their true time."""

import math

import pytest
from frame_sender import FrameSender
from sim_bench import Bench, line_of

from motord_hal.mcu.frames import FrameError, Splitter, parse, pick

TURN_RAD_S = 10.0
TICK_S = 0.02


def frames_in(data):
    for piece in Splitter().feed(data):
        try:
            yield parse(piece)
        except FrameError:
            continue  # the first frame may be incomplete


def test_after_a_standstill_the_feedback_of_a_board_carries_its_time(tmp_path):
    with Bench(tmp_path, "mcu-velocity", watchdog_s=0.0) as bench:
        sender = FrameSender(line_of(bench.profile))
        steps = [{"control": 8}, {"control": 0}, {"control": 1}]
        turning = {"control": 1, "target_velocity_1": round(TURN_RAD_S * 1000)}
        for sent in (*steps, *[turning] * 50):
            bench.send(sender.setpoints({"watchdog": 2000, **sent}, 0))
            bench.go_on(TICK_S)
        assert bench.wheel().velocity_rad_s == pytest.approx(TURN_RAD_S, rel=0.01)
        sent_before = bench.line.wire.bytes_sent
        before = list(frames_in(bench.receive(sent_before)))[-1]
        late_s = bench.now_s + 0.1
        bench.rig.work_lines(lambda: late_s)  # after a standstill of 0.1 s
        bench.rig.work_lines(lambda: late_s + TICK_S)  # its last byte has left
        bench.now_s = late_s + TICK_S
        bench.go_on(5 * TICK_S)
        for after in frames_in(bench.receive(bench.line.wire.bytes_sent - sent_before)):
            check_direction(bench.profile, before, after)
        assert after.time_us > before.time_us + 100_000


def check_direction(profile, before, after):
    """Check that the wheel has turned as far as it must between these two frames."""
    passed_s = (after.time_us - before.time_us) * 1e-6
    position = profile.registers["position_1"]
    counts = pick(after.payload, position) - pick(before.payload, position)
    wanted = TURN_RAD_S * passed_s * profile.counts_per_turn / math.tau
    assert counts == pytest.approx(wanted, rel=0.03, abs=2)
