# SPDX-License-Identifier: Apache-2.0
"""The demonstration's course, its score, and what a person is shown of it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.cli.common import Exit, Failure
from motord.cli.demo import robot_path, show
from motord.tools.course import COURSE, Pose, command_at, draw, score
from motord.tools.demo import Result

HERE = Pose(1.0, 2.0, 0.5, 10.0)
SOMEWHERE = st.floats(-100.0, 100.0)


def after(seconds, step_s=0.01):
    """Where a robot without inertia ends."""
    x_m = y_m = heading_rad = distance_m = 0.0
    for tick in range(round(seconds / step_s)):
        linear_m_s, angular_rad_s = command_at(tick * step_s, seconds)
        heading_rad += angular_rad_s * step_s
        x_m += linear_m_s * math.cos(heading_rad) * step_s
        y_m += linear_m_s * math.sin(heading_rad) * step_s
        distance_m += abs(linear_m_s) * step_s
    return Pose(x_m, y_m, heading_rad, distance_m)


def test_the_course_is_at_least_5_m_with_turns_in_under_30_s():
    assert after(20.0).distance_m > 5.0
    assert max(angular for _, _, angular in COURSE) > 0.0 > min(angular for *_, angular in COURSE)


@given(st.floats(5.0, 3600.0), st.floats(0.0, 2.0))
def test_after_its_end_the_course_is_rest(seconds, late):
    assert math.fsum(share for share, *_ in COURSE) == pytest.approx(1.0)
    assert command_at(seconds * (1.001 + late), seconds) == (0.0, 0.0)


def test_odometry_that_is_the_truth_has_no_error():
    found = score(HERE, HERE)
    assert found.ok
    assert (found.position_error_m, found.heading_error_rad, found.drift_percent) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "odometry",
    [
        Pose(1.2, 2.0, 0.5, 10.0),
        Pose(1.0, 2.0, 0.55, 10.0),
        Pose(1.0, 2.0, 0.5, 10.2),
    ],
    ids=["place", "heading", "distance"],
)
def test_each_error_alone_is_enough_to_fail(odometry):
    assert not score(odometry, HERE).ok


def test_a_robot_that_stood_still_has_not_done_well():
    still = Pose(0.0, 0.0, 0.0, 0.0)
    assert not score(still, still).ok


@given(st.floats(-10.0, 10.0), st.integers(-3, 3))
def test_a_heading_is_the_same_after_whole_turns(heading_rad, turns):
    odometry = Pose(0.0, 0.0, heading_rad, 1.0)
    truth = Pose(0.0, 0.0, heading_rad + turns * math.tau, 1.0)
    assert score(odometry, truth).heading_error_rad == pytest.approx(0.0, abs=1e-9)


@given(st.lists(st.tuples(SOMEWHERE, SOMEWHERE), min_size=1, max_size=50))
def test_every_way_fits_the_picture(path):
    rows = draw(path, columns=40, rows=10).split("\n")
    assert len(rows) <= 10
    assert max(map(len, rows)) <= 40
    assert any("X" in row for row in rows)


def result(**changes):
    """As a run of the demonstration leaves it."""
    status = {
        "state": "idle",
        "faults": [],
        "stops": 1,
        "joints": {"left": {"jumps": 0}, "right": {"jumps": 0}},
        "loop": {
            "rate_hz": 1000.0, "policy": "SCHED_OTHER", "ticks": 9000, "overruns": 7,
            "lateness_us": {"p50": 20.0, "p99": 60.0, "p99_9": 90.0, "max": 345.0},
            "step_ns": {"p50": 543.0, "p99": 900.0, "p99_9": 950.0, "max": 999.0},
            "refusals": {"scheduler": "SCHED_FIFO was refused"},
        },
        "lines": {
            "rs485": {
                "engine": "asyncio", "exchanges": 700, "errors": {"no_reply": 2, "bad_reply": 0},
                "cycle_hz": 45.0, "wire_limit_hz": 74.0,
                "round_trip_us": {"p50": 6500.0, "p99": 7000.0, "max": 9000.0},
            }
        },
    }  # fmt: skip
    path = [(0.0, 0.0), (1.0, 0.0)]
    return Result("demo", 8.0, score(HERE, HERE), path, status | changes, clean_exit=True)


def test_a_person_sees_what_was_measured_and_refused(capsys):
    show(result())
    said = capsys.readouterr().out
    for words in ("10.00 m in 8.0 s", "SCHED_OTHER", "SCHED_FIFO was refused", "345 max",
                  "7 of 9000", "700 exchanges on the asyncio engine", "errors: 2 no_reply",
                  "ends idle, faults: none"):  # fmt: skip
        assert words in said
    assert said.endswith("\nok\n")


@pytest.mark.parametrize("change", [{"state": "fault"}, {"faults": ["drive"]}])
def test_a_run_that_ends_in_a_fault_is_not_ok(change, capsys):
    show(result(**change))
    assert capsys.readouterr().out.endswith("\nNOT ok\n")


def test_a_robot_that_is_not_shipped_is_answered_with_those_that_are():
    with pytest.raises(Failure, match="skid4") as refused:
        robot_path("nonesuch")
    assert refused.value.exit_code == Exit.USAGE
