# SPDX-License-Identifier: Apache-2.0
"""Lines of text: templates write and read numbers, streams are cut, twists become wheels."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.ascii.text import LINE_BYTES_MAX, Lines, Text
from motord_hal.ascii.twist import twist_of, wheels_of
from motord_hal.fieldbus.ports import TextSpec, TextWheel

BOTH = ("left", "right")


def test_two_integers_are_written_by_their_template():
    text = Text("{left:d},{right:d}\n", BOTH)
    assert text.say({"left": 127.6, "right": -255.0}) == b"128,-255\n"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_are_written_as_zero(bad):
    assert Text("{left},{right}", BOTH).say({"left": bad, "right": 1.0}) == b"0.000,1.000"


@pytest.mark.parametrize("line", [b"e 12 -7.5", b"  e\t12  -7.5\r", b"e 12.0 -75e-1"])
def test_feedback_is_read_whatever_its_white_space(line):
    assert Text("e {left} {right}\n", BOTH).read(line) == {"left": 12.0, "right": -7.5}


@pytest.mark.parametrize("line", [b"", b"e 12", b"e 12 -7.5 3", b"f 12 -7.5", b"e nan 1", b"\xff"])
def test_an_unmatched_line_is_ignored(line):
    assert Text("e {left} {right}\n", BOTH).read(line) is None


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_written_numbers_are_read_back(left, right):
    text = Text("m {left:.4f} {right:.4f}\n", BOTH)
    read = text.read(text.say({"left": left, "right": right}))
    assert read == {"left": pytest.approx(left, abs=1e-4), "right": pytest.approx(right, abs=1e-4)}


@pytest.mark.parametrize(
    ("template", "words"),
    [
        ("hello\n", "no {field}"),
        ("{left}{right}\n", "between them"),
        ("{left},{left}\n", "twice"),
        ("{middle}\n", "unknown"),
        ("{left.real}\n", "unknown"),
        ("{left!r}\n", "a format is like"),
        ("{left:>90000}\n", "a format is like"),
        ("{left\n", "expected"),
        ("{left} µ\n", "ASCII"),
        ("{left} " + "x" * 300, "bytes"),
    ],
)
def test_a_bad_template_is_refused_with_the_reason(template, words):
    with pytest.raises(ValueError, match=words):
        Text(template, BOTH)


@given(st.integers(1, 9))
def test_lines_are_found_in_any_pieces_and_the_first_half_line_is_dropped(size):
    stream = b"alf a line\r\none\r\n\ntwo;three\nfour"
    lines = Lines()
    found = [x for at in range(0, len(stream), size) for x in lines.feed(stream[at : at + size])]
    assert found == [b"one", b"two", b"three"]


def test_a_line_without_end_is_not_kept():
    lines = Lines()
    lines.feed(b"\n")
    for _ in range(100):
        assert lines.feed(b"x" * LINE_BYTES_MAX) == []
    assert lines.feed(b"\nnew\n") == [b"new"]


@given(st.floats(-2, 2), st.floats(-4, 4))
def test_a_twist_survives_conversion_to_wheels_and_back(v, w):
    wheels = {
        "left": TextWheel(side=-1.0, radius_m=0.05),
        "right": TextWheel(side=1.0, radius_m=0.06),
    }
    spec = TextSpec(setpoints="{v} {w}", wheels=wheels, track_m=0.3)
    again = twist_of(spec, wheels_of(spec, {"v": v, "w": w}))
    assert again == {"v": pytest.approx(v, abs=1e-9), "w": pytest.approx(w, abs=1e-9)}
    assert wheels_of(spec, {"v": 0.0, "w": 1.0})["left"] < 0
