# SPDX-License-Identifier: Apache-2.0
"""Output of commands, word for word. If you mean a change, run the command that a failure names."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from motord.cli import cli
from motord.cli.common import Exit

GOLDEN = Path(__file__).parent
ROOT = GOLDEN.parents[1]
ROBOTS = sorted(path.stem for path in (ROOT / "config/robots").glob("*.toml"))


@pytest.fixture(autouse=True)
def _in_the_checkout(monkeypatch):
    monkeypatch.chdir(ROOT)


def compare(arguments, golden, status):
    result = CliRunner().invoke(cli, arguments, terminal_width=80)
    command = f".venv/bin/motord {' '.join(arguments)} > tests/golden/{golden}"
    assert result.stdout == (GOLDEN / golden).read_text(encoding="utf-8"), f"meant? {command}"
    assert result.exit_code == status


def test_help_is_the_table_of_commands():
    compare(["--help"], "help.txt", Exit.DONE)


def test_six_mistakes_are_six_lines():
    compare(["check", "tests/golden/six-mistakes.toml"], "six-mistakes.txt", Exit.USAGE)
    rows = (GOLDEN / "six-mistakes.txt").read_text(encoding="utf-8").splitlines()
    assert [int(row.split(":")[1]) for row in rows] == [6, 9, 15, 21, 26, 31]
    assert sum("did you mean" in row for row in rows) == 4


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_shipped_robot_passes(robot):
    compare(["check", f"config/robots/{robot}.toml"], f"check-{robot}.txt", Exit.DONE)
