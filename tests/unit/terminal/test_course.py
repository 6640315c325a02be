# SPDX-License-Identifier: Apache-2.0
"""The demonstration's course, its score, and the result that a person sees."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.cli.common import Exit, Failure
from motord.cli.demo import robot_path, show
from motord.config import load_robot
from motord.tools.course import COURSE, CURVES, Pose, command_at, draw, score
from motord.tools.demo import Result, course_of, source_of
from motord.tools.demo_words import Source, error_words, overrun_words

WIDE_TRACK_M = 0.7
HERE = Pose(1.0, 2.0, 0.5, 10.0)
SOMEWHERE = st.floats(-100.0, 100.0)


def after(seconds, step_s=0.01):
    """Return the pose at which a robot without inertia ends the course."""
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


def test_a_robot_that_stood_still_fails():
    still = Pose(0.0, 0.0, 0.0, 0.0)
    assert not score(still, still).ok


@given(st.floats(-10.0, 10.0), st.integers(-3, 3))
def test_a_heading_is_the_same_after_whole_turns(heading_rad, turns):
    odometry = Pose(0.0, 0.0, heading_rad, 1.0)
    truth = Pose(0.0, 0.0, heading_rad + turns * math.tau, 1.0)
    assert score(odometry, truth).heading_error_rad == pytest.approx(0.0, abs=1e-9)


@given(st.lists(st.tuples(SOMEWHERE, SOMEWHERE), min_size=1, max_size=50))
def test_every_path_fits_the_picture(path):
    rows = draw(path, columns=40, rows=10).split("\n")
    assert len(rows) <= 10
    assert max(map(len, rows)) <= 40
    assert any("X" in row for row in rows)


def test_a_base_that_cannot_turn_on_the_spot_always_goes_forward():
    for tick in range(1000):
        linear_m_s, angular_rad_s = command_at(tick / 1000, 1.0, CURVES)
        assert linear_m_s > abs(angular_rad_s) * WIDE_TRACK_M / 2


@pytest.mark.parametrize(
    ("name", "course", "source"),
    [
        ("forward-only", CURVES, Source.SPEEDS),
        ("two-single-drives", COURSE, Source.SPEEDS),
        ("pi4-encoders", COURSE, Source.COUNTERS),
        ("roboclaw", COURSE, Source.COUNTERS),
    ],
)
def test_the_robot_file_decides_which_course_it_is_and_what_odometry_comes_from(
    name, course, source
):
    robot = load_robot(robot_path(name))
    assert course_of(robot) == course
    assert source_of(robot) is source


def test_a_wheel_without_feedback_makes_odometry_use_set_points(tmp_path):
    text = robot_path("pi5-bts7960").read_text(encoding="utf-8")
    assert source_of(load_robot(robot_path("pi5-bts7960"))) is Source.COUNTERS
    blind = tmp_path / "blind.toml"
    blind.write_text(re.sub(r"\[joint\.right\.encoder\][^[]*", "", text), encoding="utf-8")
    assert source_of(load_robot(blind)) is Source.SETPOINTS


def result(source=Source.COUNTERS, found=None, held_up_s=0.0, **changes):
    """Return a result in the form of a run of the demonstration."""
    status = {
        "state": "idle",
        "faults": [],
        "why": ["left: does not turn"],
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
                "cycle_hz": 45.0, "requested_hz": 50.0, "wire_limit_hz": 74.0,
                "round_trip_us": {"p50": 6500.0, "p99": 7000.0, "max": 9000.0},
            }
        },
    }  # fmt: skip
    path = [(0.0, 0.0), (1.0, 0.0)]
    return Result(
        robot="demo", seconds=8.0, score=found or score(HERE, HERE), path=path,
        status=status | changes, clean_exit=True, source=source, drives_held_up_s=held_up_s,
    )  # fmt: skip


def shown(capsys, **what):
    show(result(**what))
    return capsys.readouterr().out


def test_an_estimate_that_is_far_off_is_ok_and_called_an_estimate(capsys):
    off = score(Pose(2.0, 3.0, 0.9, 9.0), HERE)
    assert not off.ok
    printed = shown(capsys, source=Source.SPEEDS, found=off)
    assert "an estimate, not judged" in printed
    assert "at most" not in printed
    assert printed.endswith("\nok\n")
    assert shown(capsys, found=off).endswith("\nNOT ok\n")


def test_an_estimate_of_a_robot_that_goes_elsewhere_is_not_ok(capsys):
    lost = score(Pose(0.0, 0.0, 0.0, 1.0), HERE)
    assert shown(capsys, source=Source.SPEEDS, found=lost).endswith("\nNOT ok\n")


def test_skipped_ticks_and_lost_replies_are_explained(capsys):
    printed = shown(capsys)
    assert "normal without SCHED_FIFO" in printed
    assert "no_reply: no reply in time" in printed
    assert "so few are normal here" in printed


@pytest.mark.parametrize(
    ("overruns", "words"),
    [(0, ""), (194, "normal on a computer with other work"), (4000, "many ticks were skipped")],
)
def test_how_many_ticks_were_skipped_decides_what_to_do(overruns, words):
    loop = {"policy": "SCHED_FIFO", "ticks": 21105, "overruns": overruns}
    assert words in overrun_words(loop)
    assert bool(overrun_words(loop)) == bool(words)


@pytest.mark.parametrize(
    ("errors", "words"),
    [({}, ""), ({"no_reply": 1}, "so few are normal"), ({"refused": 90}, "more than usual")],
)
def test_how_many_errors_a_line_had_decides_what_to_do(errors, words):
    printed = " ".join(error_words({"errors": errors, "exchanges": 900}))
    assert words in printed
    assert bool(printed) == bool(words)


def test_a_machine_that_was_too_busy_is_reported(capsys):
    assert "this machine was busy" not in shown(capsys)
    assert "simulated drives waited up to 0.80 s" in shown(capsys, held_up_s=0.8)


def test_a_fault_at_the_end_is_shown_with_its_reason(capsys):
    assert "left: does not turn" in shown(capsys, state="fault", faults=["stall"])


def test_the_output_shows_what_was_measured_and_refused(capsys):
    show(result())
    printed = capsys.readouterr().out
    for words in ("10.00 m in 8.0 s", "SCHED_OTHER", "SCHED_FIFO was refused", "345 max",
                  "7 of 9000", "700 exchanges on the asyncio engine", "errors: 2 no_reply",
                  "ends idle, faults: none"):  # fmt: skip
        assert words in printed
    assert printed.endswith("\nok\n")


@pytest.mark.parametrize("change", [{"state": "fault"}, {"faults": ["drive"]}])
def test_a_run_that_ends_in_a_fault_is_not_ok(change, capsys):
    show(result(**change))
    assert capsys.readouterr().out.endswith("\nNOT ok\n")


def test_a_robot_that_is_not_shipped_is_refused_with_those_that_are():
    with pytest.raises(Failure, match="skid4") as refused:
        robot_path("nonesuch")
    assert refused.value.exit_code == Exit.USAGE
