# SPDX-License-Identifier: Apache-2.0
"""A robot and its drive profiles as text: the reader gets the same values, and runs no code."""

import json
import math
from datetime import date, datetime, time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config import Problem, load_robot, transfer
from motord.config.drives.load import find_profile
from motord.config.robot_file import handed_over, taken_over
from motord.config.sections.section import Section
from motord_hal.drives import can_profile, profile

ROOT = Path(__file__).resolve().parents[3]
ROBOTS = sorted(ROOT.glob("config/robots/*.toml"))
DRIVES = sorted(path.stem for path in ROOT.glob("config/drives/*.toml"))
CLASSES = transfer.classes_of(Section, Problem) | transfer.classes_in(profile, can_profile)
LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(), st.dates(),
    st.datetimes(allow_imaginary=False).map(lambda at: at.replace(fold=0)),
    st.times().map(lambda at: at.replace(fold=0)), st.binary(),
)  # fmt: skip
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner), st.lists(inner).map(tuple), st.dictionaries(st.text(), inner),
        st.frozensets(st.text(), max_size=1),  # the text of a larger one has no certain order
    ),
    max_leaves=20,
)  # fmt: skip
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text()),
    lambda inner: st.one_of(
        st.lists(inner),
        st.dictionaries(st.text(), inner),
        st.dictionaries(st.sampled_from([*CLASSES, "dict", "Path", "time"]), inner, max_size=1),
    ),
    max_leaves=20,
)


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_a_robot_comes_back_as_it_was(path):
    robot = load_robot(path, ["robot.name=other"])
    again = taken_over(handed_over(robot))
    assert again == robot
    assert again.profiles == robot.profiles


@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_profile_comes_back_as_it_was(name):
    found = find_profile(name)
    assert transfer.loads(transfer.dumps(found), CLASSES) == found


@given(VALUES)
def test_every_value_of_toml_comes_back_with_its_type(value):
    assert repr(transfer.loads(transfer.dumps(value), {})) == repr(value)


def test_infinity_and_problems_come_back():
    problem = Problem("robot.toml", 3, "limits", "is \udcff wrong")
    given = (problem, math.inf, datetime(2026, 1, 1), date(2026, 1, 1), time(1, 2))  # noqa: DTZ001
    assert transfer.loads(transfer.dumps(given), CLASSES) == given


@given(JSON)
def test_any_other_text_is_refused_in_words_or_is_a_value_of_these_classes(found):
    try:
        transfer.loads(json.dumps(found), CLASSES)
    except ValueError:
        return


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\x80\x04N.",
        b'{"os.system": ["true"]}',
        b'{"builtins.eval": ["1"]}',
        b'{"motord.config.sections.limits.Limits": 3}',
        b'{"motord.config.problems.Problem": {"file": "a", "__class__": 3}}',
        b"[" * 100_000,
        b'{"dict": [[{"dict": []}, 1]]}',
        b"3",
    ],
)
def test_what_is_no_robot_is_an_error_with_a_reason(text):
    with pytest.raises(RuntimeError, match="no robot"):
        taken_over(text)
