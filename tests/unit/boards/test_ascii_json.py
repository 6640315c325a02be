# SPDX-License-Identifier: Apache-2.0
"""Templates that are JSON objects: they are written as given, and read by their members' names."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.ascii.text import Text

KNOWN = ("left", "right")
TEXT = Text('{{"T":1,"L":{left:.3f},"R":{right:d}}}\n', KNOWN)


def test_literal_braces_are_doubled_in_a_template():
    assert TEXT.say({"left": 0.25, "right": -3.4}) == b'{"T":1,"L":0.250,"R":-3}\n'
    assert TEXT.members == {"T": 1.0, "L": "left", "R": "right"}


@given(
    left=st.floats(-1e6, 1e6),
    right=st.integers(-(10**6), 10**6),
    others=st.dictionaries(
        st.text().filter(lambda name: name not in ("T", "L", "R")),
        st.recursive(st.none() | st.booleans() | st.integers() | st.text(), st.lists),
    ),
    order=st.randoms(),
)
def test_members_come_in_any_order_among_any_others(left, right, others, order):
    members = list({"T": 1, "L": left, "R": right, **others}.items())
    order.shuffle(members)
    line = json.dumps(dict(members)).encode()
    assert TEXT.read(line) == {"left": left, "right": right}


@pytest.mark.parametrize(
    "line",
    [
        b"", b"{}", b"[]", b"1", b'{"T":1,"L":1}', b'{"T":2,"L":1,"R":2}',
        b'{"T":1,"L":"1","R":2}', b'{"T":1,"L":true,"R":2}', b'{"T":1,"L":NaN,"R":2}',
        b'{"T":1,"L":1e999,"R":2}', b'{"T":1,"L":1,"R":2', b'{"T":1,"L":null,"R":2}',
    ],
)  # fmt: skip
def test_an_unmatched_line_is_ignored(line):
    assert TEXT.read(line) is None


@pytest.mark.parametrize(
    ("template", "why"),
    [
        ('{{"L":{left}', "begins like a JSON object but is not one"),
        ('{{"L":{left}}} {right}', "begins like a JSON object but is not one"),
        ('{{"L":{left},"s":"x"}}', "must be a number or a"),
        ('{{"L":{left},"o":{{}}}}', "must be a number or a"),
        ('{{"L":{left},"b":true}}', "must be a number or a"),
        ('{{"":{left}}}', "has 1 character or more"),
    ],
)
def test_a_template_that_is_no_object_of_numbers_is_refused_with_the_reason(template, why):
    with pytest.raises(ValueError, match=why):
        Text(template, KNOWN)
