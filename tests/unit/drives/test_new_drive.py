# SPDX-License-Identifier: Apache-2.0
"""A new drive profile made from a person's answers, as docs/drives/your-own-drive.md describes."""

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from motord.cli.files.drives import drives
from motord.config.drives.load import load_profile

PAGE = (Path(__file__).parents[3] / "docs/drives/your-own-drive.md").read_text(encoding="utf-8")


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def invoke(*args, typed=None):
        return CliRunner().invoke(drives, args, input=typed)

    return invoke


def test_the_page_s_commands_work_as_written(run):
    answers = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL).group(1)
    Path("answers.toml").write_text(answers, encoding="utf-8")
    commands = re.findall(r"```sh\n(.*?)\n```", PAGE, re.DOTALL)
    assert len(commands) == 3
    for command in commands:
        motord, verb, *rest = shlex.split(command)
        assert (motord, verb) == ("motord", "drives")
        result = run(*rest)
        assert result.exit_code == 0, result.output
    assert load_profile(Path("example42.toml")).watchdog is not None


def test_questions_with_their_defaults_make_a_good_profile(run):
    assert run("new", "mine", typed="\n" * 20).exit_code == 0
    assert load_profile(Path("mine.toml")).watchdog_note


def test_an_existing_file_is_never_written_over(run):
    Path("mine.toml").write_text("precious", encoding="utf-8")
    assert run("new", "mine.toml", typed="\n" * 20).exit_code != 0
    assert Path("mine.toml").read_text(encoding="utf-8") == "precious"


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ("speed_adress = 1", "speed_adress"),
        ("baudrate = true", "must be int"),
        ("velocity_address = 0x0200", "overlaps"),
        ("title = 'a \"b'", "no quotes"),
        ("title = ", "answers.toml"),
    ],
)
def test_bad_answers_are_named_and_leave_no_file(run, answers, message):
    Path("answers.toml").write_text(answers, encoding="utf-8")
    result = run("new", "mine.toml", "--answers", "answers.toml")
    assert result.exit_code != 0
    assert message in result.output
    assert not Path("mine.toml").exists()
