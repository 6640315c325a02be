# SPDX-License-Identifier: Apache-2.0
"""Least coverage of each file of csrc/: tests/c/thresholds.py and its table."""

import pytest
from tests.c.mutants import CSRC, code_files
from tests.c.thresholds import percent, raised, reached, read_table, shortfalls


def test_each_c_file_has_its_numbers():
    listed = {name for name in read_table() if name.endswith(".c")}
    assert listed == {str(path.relative_to(CSRC)) for path in CSRC.rglob("*.c")}


def test_mutants_of_each_c_file_are_made():
    assert {path.name for path in CSRC.rglob("*.c")} <= set(code_files())


@pytest.mark.parametrize(
    ("covered", "total", "expected"), [(2, 3, 66.6), (999, 1000, 99.9), (3, 3, 100.0), (0, 0, 100)]
)
def test_a_percentage_is_rounded_down_and_of_nothing_it_is_all(covered, total, expected):
    assert percent(covered, total) == expected


def of_file(name, lines, branches):
    return {
        "filename": name, "line_covered": lines, "line_total": 10,
        "branch_covered": branches, "branch_total": 10,
    }  # fmt: skip


def test_a_file_is_too_low_by_its_lines_or_its_branches_or_without_numbers():
    found = reached({"files": [of_file("a.c", 9, 8), of_file("b.c", 10, 10)]})
    assert found == {"a.c": (90.0, 80.0), "b.c": (100.0, 100.0)}
    assert shortfalls(found, {"a.c": (90.0, 80.0), "b.c": (100.0, 100.0)}) == []
    assert len(shortfalls(found, {"a.c": (90.1, 80.1)})) == 3


def test_written_numbers_only_become_higher():
    table = {"a.c": (95.0, 50.0), "gone.c": (1.0, 1.0)}
    found = {"a.c": (90.0, 80.0), "b.c": (10.0, 20.0)}
    assert raised(found, table) == {"a.c": (95.0, 80.0), "b.c": (10.0, 20.0)}
