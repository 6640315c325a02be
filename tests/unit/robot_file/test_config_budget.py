# SPDX-License-Identifier: Apache-2.0
"""The time that the drives of a line need on its wire, and the report when it is too long."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.rules.wiring.wire import budget, cycle_limit_hz, helps
from motord.config.wiring import line_specs
from motord_hal.drives.profile import Gap

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
CHARACTER_S = 10 / 115200
GAP_S = 1.75e-3


def bare(spec):
    """Return the line without the registers that are not read in each cycle."""
    joints = []
    for joint in spec.joints:
        profile = joint.profile
        channels = {
            number: replace(channel, current=None, temperature=None)
            for number, channel in profile.channels.items()
        }
        bare = replace(
            profile, channels=channels, bus_voltage=None, enabled=None, watchdog=None, configure=()
        )
        joints.append(replace(joint, profile=bare))
    return replace(spec, joints=tuple(joints))


@pytest.fixture
def spec():
    robot = load_robot(ROBOTS / "demo.toml")
    return bare(line_specs(robot, {"zlac8015d": robot.profiles["zlac8015d"]})[0])


# Computed by hand: both set-points take 13 bytes and an answer of 8; 20A5h to 20ACh 8 and 21. Each
# exchange has two gaps.
WRITE_S = 21 * CHARACTER_S + 2 * GAP_S
READ_S = 29 * CHARACTER_S + 2 * GAP_S


def test_a_line_needs_the_time_of_its_frames_and_gaps(spec):
    need = budget(spec)
    assert (need.drives, need.cycle_hz) == (1, 50.0)
    assert need.share == pytest.approx(50 * (WRITE_S + READ_S))
    assert need.most_hz == pytest.approx(1 / (WRITE_S + READ_S))
    assert cycle_limit_hz(spec) == pytest.approx(1 / (WRITE_S + READ_S))


def test_a_drive_that_answers_at_the_latest_takes_its_turnaround_in_place_of_the_second_gap(spec):
    turnaround_s = spec.joints[0].profile.turnaround_s
    assert turnaround_s > GAP_S
    least_hz = 1 / (WRITE_S + READ_S + 2 * (turnaround_s - GAP_S))
    assert budget(spec).least_hz == pytest.approx(least_hz)


def test_each_drive_counts_at_its_own_rate(spec):
    slow = tuple(replace(joint, unit=2, cycle_hz=10.0) for joint in spec.joints)
    need = budget(replace(spec, joints=(*spec.joints, *slow)))
    assert need.drives == 2
    assert need.share == pytest.approx(60 * (WRITE_S + READ_S))


def test_what_helps_is_computed_for_this_line(spec):
    gap_s = 3.5 * CHARACTER_S
    both_s = (13 + 4 + 21) * CHARACTER_S + 2 * GAP_S  # function 23: 17 bytes, an answer of 21
    help_wanted = dict(helps(replace(spec, cycle_hz=100.0)))
    assert help_wanted == {
        "function 23 where the drives have it": pytest.approx(1 / both_s),
        'gap = "3.5char"': pytest.approx(1 / (50 * CHARACTER_S + 4 * gap_s)),
        "baudrate = 230400": pytest.approx(1 / (50 * 10 / 230400 + 4 * GAP_S)),
    }
    assert 'gap = "3.5char"' not in dict(helps(replace(spec, gap=Gap.CHARACTERS)))


def test_a_requested_rate_beyond_the_wire_is_an_error_with_remedies():
    with pytest.raises(ConfigError) as caught:
        load_robot(ROBOTS / "skid4.toml", ["line.rs485.cycle_hz=100"])
    (row,) = caught.value.problems
    figures = re.fullmatch(
        r"line rs485: 2 drives at 100 Hz need (\d+) % of the wire; most it carries is ([\d.]+) Hz "
        r"\(function 23 where the drives have it: [\d.]+ Hz; gap = \"3.5char\": [\d.]+ Hz; "
        r"baudrate = 921600: [\d.]+ Hz\)",
        row.text,
    )
    assert (row.key, float(figures[1]) * float(figures[2])) == (
        "line.rs485.cycle_hz",
        pytest.approx(100 * 100, rel=0.01),
    )


def test_a_default_rate_beyond_the_wire_is_a_warning(tmp_path):
    text = (ROBOTS / "skid4.toml").read_text(encoding="utf-8")
    assert "cycle_hz = 30\n" in text
    path = tmp_path / "robot.toml"
    path.write_text(text.replace("cycle_hz = 30\n", ""), encoding="utf-8")
    rows = [row.text for row in load_robot(path).warnings]
    assert any(row.startswith("line rs485: 2 drives at 50 Hz need 136 %") for row in rows)
