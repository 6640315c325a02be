# SPDX-License-Identifier: Apache-2.0
"""`motord scan` against simulated drives on a pty: which units answer, which drive each is, and
which program holds the port."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from motord.tools.simulator import start_simulator

ROOT = Path(__file__).resolve().parents[3]


def scan(*arguments, within_s=100):
    return subprocess.run(
        [sys.executable, "-m", "motord", "scan", *map(str, arguments)],
        capture_output=True, text=True, timeout=within_s, cwd=ROOT,
    )  # fmt: skip


@pytest.fixture
def line(tmp_path):
    """A simulated line with two single drives, units 1 and 2."""
    with start_simulator(
        ROOT / "config/robots/two-single-drives.toml", link_dir=tmp_path
    ) as simulator:
        yield simulator


def port_of(simulator):
    return next(iter(simulator.ports.values()))


def profile_of():
    text = (ROOT / "config/robots/two-single-drives.toml").read_text(encoding="utf-8")
    return next(row.split('"')[1] for row in text.splitlines() if row.startswith("drive = "))


def baudrate_of(simulator):
    text = (ROOT / "config/robots/two-single-drives.toml").read_text(encoding="utf-8")
    rows = [row for row in text.splitlines() if row.startswith("baudrate = ")]
    return rows[0].split(" = ")[1].split()[0]


def test_the_drives_are_found_with_their_profile_and_nothing_is_written(line):
    run = scan(port_of(line), "--units", "1-3", "--baudrate", baudrate_of(line), "--json")
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)["found"]
    assert [one["unit"] for one in found] == [1, 2]
    for one in found:
        best = one["matches"][0]
        assert best["profile"] == profile_of()
        assert best["fitting"] == best["asked"] > 3
    assert "at most" in run.stderr
    truth = line.control.call("truth")
    assert (truth["at_rest"], truth["moved_max_m_s"]) == (True, 0.0)


def test_the_output_for_people_has_the_lines_for_the_robot_file(line):
    run = scan(port_of(line), "--unit", "2", "--baudrate", baudrate_of(line))
    assert run.returncode == 0, run.stderr
    assert f'drive = "{profile_of()}", unit = 2' in run.stdout
    assert f"baudrate = {baudrate_of(line)}" in run.stdout


def test_no_unit_answers_until_the_right_baud_rate_is_tried(line):
    wrong = "57600" if baudrate_of(line) != "57600" else "9600"
    run = scan(port_of(line), "--unit", "1", "--baudrate", wrong)
    assert run.returncode == 1
    assert "no unit answers" in run.stderr
    usual = scan(port_of(line), "--unit", "1", "--json")
    assert usual.returncode == 0, usual.stderr
    assert str(json.loads(usual.stdout)["found"][0]["baudrate"]) == baudrate_of(line)


def test_a_scan_without_results_is_reported_within_the_bound(line):
    run = scan(port_of(line), "--units", "100-247", "--within-s", "1")
    assert run.returncode == 1
    assert "stopped after 1 s" in run.stderr


def test_a_port_that_another_program_uses_is_refused_with_the_program_s_name(line):
    from motord.tools.scan import spec_of
    from motord_hal.fieldbus.ports import DirectionSpec
    from motord_hal.serial.port import open_port

    held = open_port(spec_of(port_of(line), 9600, "none", DirectionSpec()))
    try:
        run = scan(port_of(line), "--unit", "1")
        assert run.returncode == 3
        assert str(os.getpid()) in run.stderr or "another program" in run.stderr
    finally:
        held.close()


def test_a_missing_port_is_missing_hardware(tmp_path):
    run = scan(tmp_path / "ttyUSB9")
    assert run.returncode == 3
    assert "ttyUSB9" in run.stderr


@pytest.mark.parametrize("units", ["-1", "1-253", "5-2", "all"])
def test_units_out_of_range_are_wrong_usage(units):
    assert scan("/dev/null", "--units", units).returncode == 2


def test_the_self_test_reports_which_direction_works(line):
    line.control.inject("echo")
    port, baudrate = port_of(line), baudrate_of(line)
    run = scan(port, "--directions", "--unit", "1", "--baudrate", baudrate)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == ['direction = "auto"', 'echo = "yes"']
    assert "kernel:" in run.stderr


def test_a_drive_that_refuses_with_code_zero_is_found_as_one_that_refuses(line):
    line.control.inject("exception:code=0,unit=1")
    run = scan(port_of(line), "--units", "1-2", "--baudrate", baudrate_of(line), "--json")
    assert run.returncode == 0, run.stderr
    first, second = json.loads(run.stdout)["found"]
    assert (first["answer"], first["matches"]) == ("refuses register 0 (0)", [])
    assert second["matches"][0]["profile"] == profile_of()


@pytest.mark.parametrize(
    ("robot", "kind", "units"),
    [("turtlebot3-burger", "dynamixel", [1, 2]), ("two-bus-servos", "feetech", [7, 9])],
)
def test_bus_servos_are_found_by_pings_with_their_profile(robot, kind, units, tmp_path):
    with start_simulator(ROOT / f"config/robots/{robot}.toml", link_dir=tmp_path) as simulator:
        run = scan(port_of(simulator), "--units", "1-9", "--baudrate", "1000000", "--json")
        assert run.returncode == 0, run.stderr
        found = json.loads(run.stdout)["found"]
        assert [(one["kind"], one["unit"]) for one in found] == [(kind, unit) for unit in units]
        profile = {"dynamixel": "xl430", "feetech": "sts3215"}[kind]
        assert [one["matches"][0]["profile"] for one in found] == [profile, profile]
        assert simulator.control.call("truth")["moved_max_m_s"] == 0.0
