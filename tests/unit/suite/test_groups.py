# SPDX-License-Identifier: Apache-2.0
"""The hooks of tests/conftest.py for tests that run side by side, and for long tests."""

import os
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def shared():
    """Stands for a daemon or a browser that a whole file uses."""


def test_tests_that_share_a_fixture_of_their_file_stay_in_one_process(shared, request):
    if not request.config.getoption("loadgroup", default=False):
        pytest.skip("only one process, or another --dist than loadgroup")
    assert request.node.nodeid.endswith("@tests/unit/suite/test_groups.py")


@pytest.fixture
def ran(tmp_path):
    """Return a function that runs pytest on the files in tmp_path and returns its output."""
    (tmp_path / "conftest.py").write_text("from tests.conftest import *\n")

    def ran(*options):
        command = [sys.executable, "-m", "pytest", "-v", f"--rootdir={tmp_path}", *options]
        where = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        where.pop("PYTEST_XDIST_WORKER", None)
        return subprocess.run(
            command, cwd=tmp_path, env=where, capture_output=True, text=True, timeout=300
        ).stdout

    return ran


def test_only_the_failed_tests_of_a_group_run_again_without_groups(tmp_path, ran):
    (tmp_path / "test_two.py").write_text(
        "import pytest\n\n"
        "@pytest.fixture(scope='module')\ndef shared():\n    pass\n\n"
        "def test_fails(shared):\n    assert 0\n\n"
        "def test_passes(shared):\n    pass\n"
    )

    assert "1 failed, 1 passed" in ran("-n", "1", "--dist", "loadgroup")
    again = ran("-n", "0", "--last-failed")
    assert "1 failed" in again
    assert "passed" not in again


def test_long_tests_are_left_out_unless_their_file_is_named(tmp_path, ran):
    (tmp_path / "test_two.py").write_text(
        "import pytest\n\n"
        "@pytest.mark.long\ndef test_long():\n    pass\n\n"
        "def test_short():\n    pass\n"
    )
    mark = ("-o", "markers=long: as in pyproject.toml")
    assert "1 passed, 1 deselected" in ran(*mark, "--without-long")
    side_by_side = ran(*mark, "--without-long", "-n", "1")
    assert "1 passed" in side_by_side
    assert "::test_long" not in side_by_side
    assert "2 passed" in ran(*mark, "--without-long", "test_two.py")
    assert "2 passed" in ran(*mark)
