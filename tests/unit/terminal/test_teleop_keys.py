# SPDX-License-Identifier: Apache-2.0
"""A key moves the robot while it is held, and never after it has been released."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from motord.tools.teleop.keys import (
    BURST,
    KEY_AGE_MAX_S,
    MOTIONS,
    PINGS_MAX,
    PONG,
    SILENCE_S,
    UNANSWERED_AFTER_S,
    DeadMan,
    Decoder,
    Link,
)
from motord.tools.teleop.session import Speeds

HOLD_S, FIRST_S = 0.2, 0.6


@pytest.fixture
def dead_man():
    return DeadMan(hold_s=HOLD_S, first_s=FIRST_S)


def repeat(dead_man, start_s, count, period_s=0.033, key="w"):
    for number in range(count):
        dead_man.take([key], start_s + number * period_s, 0.0)
    return start_s + (count - 1) * period_s


def test_without_a_key_nothing_moves(dead_man):
    assert dead_man.motion(0.0) is None


def test_the_first_press_lasts_until_the_terminal_repeats_it(dead_man):
    dead_man.take(["w"], 1.0, 0.0)
    assert dead_man.motion(1.0 + FIRST_S - 0.01) == MOTIONS["w"]
    assert dead_man.motion(1.0 + FIRST_S) is None


def test_the_motion_ends_soon_after_the_last_repeat(dead_man):
    last_s = repeat(dead_man, 1.0, 30)
    assert dead_man.motion(last_s + HOLD_S - 0.01) == MOTIONS["w"]
    assert dead_man.motion(last_s + HOLD_S) is None


def test_another_key_is_a_press_of_its_own(dead_man):
    last_s = repeat(dead_man, 1.0, 30)
    dead_man.take(["a"], last_s + 0.01, 0.0)
    assert dead_man.motion(last_s + 0.01 + FIRST_S - 0.01) == MOTIONS["a"]


def test_of_keys_read_at_once_the_newest_counts_and_as_a_repeat(dead_man):
    dead_man.take(["w", "w", "s"], 1.0, 0.0)
    assert dead_man.motion(1.0) == MOTIONS["s"]
    assert dead_man.motion(1.0 + HOLD_S) is None


def test_a_burst_moves_nothing_even_where_the_terminal_answers_no_ping(dead_man):
    dead_man.take(["w"] * BURST, 1.0, 0.0)
    assert dead_man.motion(1.0) is None
    assert dead_man.barred(1.0)


def test_a_burst_that_comes_in_pieces_moves_nothing(dead_man):
    end_s = repeat(dead_man, 1.0, 40, period_s=0.005)
    assert dead_man.motion(end_s) is None


def test_after_a_burst_a_held_key_has_to_be_released_first(dead_man):
    dead_man.take(["w"] * BURST, 1.0, 0.0)
    end_s = repeat(dead_man, 1.1, 60)
    assert dead_man.motion(end_s) is None
    dead_man.take(["w"], end_s + SILENCE_S + 0.01, 0.0)
    assert dead_man.motion(end_s + SILENCE_S + 0.01) == MOTIONS["w"]


def test_a_key_that_may_be_old_stops_the_robot(dead_man):
    last_s = repeat(dead_man, 1.0, 30)
    dead_man.take(["w"], last_s + 0.03, KEY_AGE_MAX_S + 0.001)
    assert dead_man.motion(last_s + 0.03) is None


@given(
    st.lists(st.floats(0.0, 2.0), min_size=1, max_size=60),
    st.lists(st.floats(0.0, 3.0), min_size=1, max_size=60),
)
def test_no_key_moves_the_robot_for_longer_than_a_first_press(gaps_s, ages_s):
    dead_man, now_s = DeadMan(hold_s=HOLD_S, first_s=FIRST_S), 0.0
    for gap_s, age_s in zip(gaps_s, ages_s, strict=False):
        now_s += gap_s
        dead_man.take(["w"], now_s, age_s)
        if age_s > KEY_AGE_MAX_S:
            assert dead_man.motion(now_s) is None
    assert dead_man.motion(now_s + FIRST_S) is None


def test_a_key_is_as_old_as_the_newest_answered_ping():
    link = Link(0.0)
    link.pinged(1.0)
    link.pinged(1.05)
    link.answered(1.1)
    assert link.key_age_s(1.1) == pytest.approx(0.1)
    assert link.round_trip_s == pytest.approx(0.1)
    link.answered(1.12)
    assert link.key_age_s(1.12) == pytest.approx(0.07)


def test_after_a_stall_the_keys_from_the_buffer_are_old():
    """The terminal answered each ping at its time, but the link delivers all answers at once."""
    link, now_s = Link(0.0), 0.0
    while link.may_ping:
        link.pinged(now_s)
        now_s += 0.05
    for _ in range(PINGS_MAX):
        link.answered(3.0)
        assert link.key_age_s(3.0) > KEY_AGE_MAX_S


def test_an_answer_without_a_ping_proves_nothing():
    link = Link(0.0)
    link.answered(5.0)
    assert link.round_trip_s is None
    assert link.answers(5.0) is False


def test_before_the_first_answer_a_key_counts_as_old():
    link = Link(0.0)
    link.pinged(0.0)
    assert link.key_age_s(0.1) > KEY_AGE_MAX_S
    assert link.answers(UNANSWERED_AFTER_S + 0.1) is False
    assert link.key_age_s(UNANSWERED_AFTER_S + 0.1) == 0.0
    link.answered(9.0)  # the terminal does answer, but slowly
    assert link.key_age_s(9.0) == 9.0


def test_arrows_are_letters_and_sequences_may_come_in_pieces():
    decoder = Decoder()
    assert list(decoder.feed(b"W\x1b[A\x1bOD\x1b[")) == ["w", "w", "a"]
    assert list(decoder.feed(b"0")) == []
    assert list(decoder.feed(b"n ")) == [PONG, " "]


@pytest.mark.parametrize("broken", [b"\x1bO", b"\x1b[", b"\x1b[1;", b"\x1b[ ", b"\x1b"])
def test_a_sequence_that_another_breaks_off_swallows_no_key(broken):
    *_, arrow, pong, key = Decoder().feed(broken + b"\x1b[A\x1b[0nd")
    assert [arrow, pong, key] == ["w", PONG, "d"]


@given(st.lists(st.binary(max_size=20), max_size=20))
@example([b"\x1bO"])
@example([b"\x1b[", b"\x1b"])
def test_any_bytes_are_decoded_without_an_error(pieces):
    decoder = Decoder()
    for piece in pieces:
        list(decoder.feed(piece))
    assert list(decoder.feed(b"\x1b[0n" * 20))[-1] == PONG


def test_speed_steps_stay_between_a_tenth_and_all():
    speeds = Speeds(1.0, 2.0)
    for _ in range(20):
        speeds.step(up=True)
    assert speeds.part == 1.0
    for _ in range(20):
        speeds.step(up=False)
    assert speeds.part == pytest.approx(0.1)
