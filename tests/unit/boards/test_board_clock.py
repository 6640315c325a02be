# SPDX-License-Identifier: Apache-2.0
"""Conversion from the board's clock to the computer's: a frame that waited keeps its age."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.realtime.board import BoardClock

MS = 1_000_000
SAMPLES_KEPT = 32
"""Value of BOARD_CLOCK_SAMPLES in csrc/api/line/api_board.h."""
WRAP_US = 1 << 32


@given(
    start_us=st.integers(0, WRAP_US - 1),
    steps=st.lists(st.tuples(st.integers(1, 50), st.integers(0, 30)), min_size=1, max_size=60),
)
def test_no_stamp_is_later_than_the_arrival_of_its_frame(start_us, steps):
    clock, board_ms = BoardClock(), 0
    for step_ms, delay_ms in steps:
        board_ms += step_ms
        came_ns = (board_ms + delay_ms) * MS
        stamp_ns = clock.stamp_ns((start_us + board_ms * 1000) % WRAP_US, came_ns)
        assert stamp_ns <= came_ns


@given(late_ms=st.integers(1, 60), frames=st.integers(1, 60))
def test_when_the_delay_falls_stamps_are_not_squeezed_together(late_ms, frames):
    clock = BoardClock()
    newest = None
    for n in range(SAMPLES_KEPT + frames):
        delay_ms = late_ms if n < SAMPLES_KEPT + frames // 2 else 0
        came_ns = max((n * 10 + delay_ms) * MS, newest[2] if newest else 0)
        stamp_ns = clock.stamp_ns(n * 10_000, came_ns)
        assert stamp_ns <= came_ns
        if newest is None or stamp_ns > newest[0]:
            assert newest is None or 1.5 * (stamp_ns - newest[0]) >= n * 10 * MS - newest[1]
            newest = (stamp_ns, n * 10 * MS, came_ns)


def test_frames_that_waited_get_the_time_at_which_they_were_made():
    clock = BoardClock()
    for n in range(10):
        assert clock.stamp_ns(n * 20_000, n * 20 * MS) == n * 20 * MS
    late_ns = 1000 * MS  # the process was stopped; all frames arrive at once
    stamps = [clock.stamp_ns(n * 20_000, late_ns) for n in range(10, 20)]
    assert stamps == [n * 20 * MS for n in range(10, 20)]


def test_a_wrap_of_the_board_clock_causes_no_jump():
    clock = BoardClock()
    first_ns = clock.stamp_ns(WRAP_US - 10_000, 0)
    assert clock.stamp_ns(10_000, 20 * MS) - first_ns == 20 * MS


def test_a_slow_clock_makes_stamps_only_slightly_older():
    clock = BoardClock()
    for n in range(1, 1000):
        came_ns = n * 20 * MS
        age_ns = came_ns - clock.stamp_ns(round(n * 20_000 * 0.995), came_ns)
        assert 0 <= age_ns <= 0.006 * SAMPLES_KEPT * 20 * MS


def test_the_clock_of_a_restarted_board_is_used_at_once():
    clock = BoardClock()
    for n in range(50):
        clock.stamp_ns(600_000_000 + n * 20_000, n * 20 * MS)
    assert clock.stamp_ns(0, 2000 * MS) == pytest.approx(2000 * MS)
