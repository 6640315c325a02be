# SPDX-License-Identifier: Apache-2.0
"""A test that fails is run again only while the machine was late."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.late_machine import Watch

ROOT = Path(__file__).resolve().parents[3]
CONFTEST = "from tests.late_machine import pytest_runtest_protocol, pytest_terminal_summary\n"
TEST = """
import ctypes, pathlib, pytest

runs = pathlib.Path(__file__).with_suffix(".runs")

@pytest.fixture
def number():
    seen = int(runs.read_text()) if runs.exists() else 0
    runs.write_text(str(seen + 1))
    return seen + 1

def test_deadline(number):
    if {hold_s}:
        ctypes.PyDLL(None).usleep(int({hold_s} * 1e6))  # the other threads do not run meanwhile
    assert number >= {good_at}
"""

HANGS = """
import ctypes, pathlib, time

runs = pathlib.Path(__file__).with_suffix(".runs")

def test_it_hangs():
    runs.write_text("1" + runs.read_text() if runs.exists() else "1")
    ctypes.PyDLL(None).usleep(200_000)  # the machine is late
    time.sleep(100)
"""


@pytest.fixture
def ran(tmp_path):
    def run(hold_s, good_at, again_max_s=60.0):
        """Run pytest on TEST; return its exit status, the number of runs, and its output."""
        bounds = (
            f"tests.late_machine.AGAIN_MAX_S = {again_max_s}\ntests.late_machine.CALM_WITHIN_S = 0"
        )
        conftest = f"import tests.late_machine\n{CONFTEST}{bounds}\n"
        (tmp_path / "conftest.py").write_text(conftest, encoding="utf-8")
        test = tmp_path / "test_it.py"
        test.write_text(TEST.format(hold_s=hold_s, good_at=good_at), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        found = subprocess.run(
            [*command, "--rootdir", tmp_path, "-c", "/dev/null", test],
            cwd=ROOT, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        return found.returncode, int(test.with_suffix(".runs").read_text()), found.stdout

    return run


def test_a_failure_while_the_machine_was_late_is_run_again_with_new_fixtures(ran):
    code, runs, out = ran(hold_s=0.3, good_at=3)
    assert (code, runs) == (0, 3)
    assert "run again: the machine was late" in out
    assert out.count("test_it.py::test_deadline: a thread woke 0.") == 2


def test_a_failure_that_comes_each_time_is_a_failure(ran):
    code, runs, out = ran(hold_s=0.3, good_at=99)
    assert (code, runs) == (1, 4)
    assert "1 failed" in out


def test_a_test_whose_runs_took_long_is_not_run_again(ran):
    assert ran(hold_s=1.0, good_at=3, again_max_s=1.9)[:2] == (1, 2)
    assert ran(hold_s=0.3, good_at=4, again_max_s=0.1)[:2] == (1, 3)


def test_a_test_that_hung_is_not_run_again(tmp_path):
    (tmp_path / "conftest.py").write_text(CONFTEST, encoding="utf-8")
    test = tmp_path / "test_it.py"
    test.write_text(HANGS, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--timeout", "1"]
    found = subprocess.run(
        [*command, "--rootdir", tmp_path, "-c", "/dev/null", test],
        cwd=ROOT, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert (found.returncode, test.with_suffix(".runs").read_text()) == (1, "1")
    assert "Timeout" in found.stdout


def test_a_test_that_passes_is_run_once_however_late_the_machine_is(ran):
    assert ran(hold_s=0.3, good_at=1)[:2] == (0, 1)


@pytest.mark.parametrize(
    ("late_s", "crowd", "late"), [(0.05, 2.0, False), (0.051, 0.0, True), (0.0, 2.1, True)]
)
def test_delay_or_load_makes_a_machine_late(late_s, crowd, late):
    watch = Watch()
    watch.late_s, watch.looks = late_s, 1
    watch.waiting = crowd * os.cpu_count()
    assert bool(watch.why) == late
