# SPDX-License-Identifier: Apache-2.0
"""TAB completes in real shells, and the man pages follow man(7)."""

import os
import shutil
import subprocess
import sys

import pytest
from click.testing import CliRunner

from motord.cli import COMMANDS, cli
from motord.cli.man import pages


def script(shell):
    result = CliRunner().invoke(cli, ["completion", shell], prog_name="motord")
    assert result.exit_code == 0
    return result.stdout


@pytest.fixture
def shell(tmp_path):
    """Return a function that runs a shell script in which `motord` is the one under test."""
    program = tmp_path / "motord"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m motord "$@"\n')
    program.chmod(0o755)
    environ = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(tmp_path)}

    def run(name, words):
        if shutil.which(name) is None:
            pytest.skip(f"needs {name}")
        (tmp_path / "script").write_text(script(name))
        done = subprocess.run(
            [name, "-c", words.format(script=tmp_path / "script")],
            env=environ, capture_output=True, text=True, timeout=100, check=True,
        )  # fmt: skip
        return done.stdout.split("\n")

    return run


BASH = (
    "source {script}; COMP_WORDS=(%s); COMP_CWORD=%d; _motord_completion motord;"
    ' printf "%%s\\n" "${{COMPREPLY[@]}}"'
)


def test_bash_completes_commands_and_drives(shell):
    assert {"teleop", "top", "turn"} <= set(shell("bash", BASH % ("motord t", 1)))
    assert "zlac8015d" in shell("bash", BASH % ("motord drives zla", 2))


def test_fish_completes_commands_with_their_help(shell):
    rows = shell("fish", 'source {script}; complete -C "motord tel"')
    assert any(row.startswith("teleop\t") for row in rows)


def test_zsh_takes_the_script(shell):
    shell("zsh", "autoload -U compinit; compinit -u; source {script}")


def test_without_a_daemon_nothing_is_offered_and_nothing_is_printed(monkeypatch, tmp_path):
    monkeypatch.setattr("motord.cli.complete.find_socket", lambda _: tmp_path / "none.sock")
    found = CliRunner().invoke(
        cli, [], prog_name="motord",
        env={"_MOTORD_COMPLETE": "bash_complete", "COMP_WORDS": "motord params get lim",
             "COMP_CWORD": "3"},
    )  # fmt: skip
    assert found.output.strip() == ""


def test_there_is_a_man_page_for_every_command():
    found = dict(pages())
    assert set(found) == {"motord.1", *(f"motord-{name}.1" for name in COMMANDS)}
    for text in found.values():
        assert ".SH SYNOPSIS" in text
        assert "\b" not in text


def test_the_man_pages_name_the_short_form_of_help(tmp_path):
    # a process of its own: click keeps the help option of a command that was shown once
    subprocess.run([sys.executable, "-m", "motord.cli.man", str(tmp_path)], check=True, timeout=60)
    written = [path.read_text("utf-8") for path in tmp_path.iterdir()]
    assert len(written) == len(COMMANDS) + 1
    assert all(".B \\-h, \\-\\-help" in text for text in written)


def test_the_man_pages_leave_the_help_as_it_is():
    dict(pages())
    assert "  -h, --help " in CliRunner().invoke(cli, ["--help"]).output


def test_the_man_pages_are_without_warnings(tmp_path):
    if shutil.which("mandoc") is None:
        pytest.skip("needs mandoc")
    for name, text in pages():
        (tmp_path / name).write_text(text)
    done = subprocess.run(
        ["mandoc", "-T", "lint", "-W", "warning", *map(str, tmp_path.iterdir())],
        capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert [row for row in done.stdout.splitlines() if "missing date" not in row] == []
