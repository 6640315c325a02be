# SPDX-License-Identifier: Apache-2.0
"""A named pipe without a writer, or a device, in the place of a file: every command that reads the
file refuses it with its name. Reading it would never end."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from motord.api.page_file import own_page
from motord.api.state_page import NoPage, StatePage
from motord.bus.http_server import tls_context
from motord.bus.messages.journal import Journal, NoJournal
from motord.bus.secret import read_secret
from motord_hal.base import bounded

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "config/robots/demo.toml"
DRIVES = ROOT / "config/drives"
ENDS_WITHIN_S = 120.0
KINDS = {"pipe": os.mkfifo, "device": lambda path: path.symlink_to("/dev/zero")}


@pytest.fixture(params=KINDS)
def special(request, tmp_path):
    """Put a special file in a place; return its path."""

    def put(name):
        path = tmp_path / name
        KINDS[request.param](path)
        return path

    return put


def refused(special, *words):
    done = subprocess.run(
        [sys.executable, "-m", "motord", *map(str, words)],
        capture_output=True, text=True, timeout=ENDS_WITHIN_S, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode in (1, 2), done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert str(special) in done.stdout + done.stderr
    assert "is not a regular file" in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("robot.toml", ["check", "FILE"]),
        ("mine.toml", ["drives", "--check", "FILE"]),
        ("log.csv", ["calibrate", "--from", "FILE", "--file", DEMO, "--yes"]),
        ("log.mcap", ["calibrate", "--from", "FILE", "--file", DEMO, "--yes"]),
        ("fault.mcap", ["replay", "FILE"]),
        ("before.json", ["latency", "--compare", "FILE", DEMO]),
        ("answers.toml", ["drives", "new", "new.toml", "--answers", "FILE"]),
    ],
    ids=lambda value: " ".join(map(str, value[:2])) if isinstance(value, list) else value,
)
def test_a_command_refuses_a_special_file(special, name, words):
    path = special(name)
    refused(path, *(path if word == "FILE" else word for word in words))


def test_check_refuses_a_profile_that_is_no_file(special, tmp_path):
    path = special("mine.toml")
    text = DEMO.read_text(encoding="utf-8").replace('drive = "zlac8015d"', 'drive = "mine.toml"')
    assert "mine.toml" in text
    (tmp_path / "robot.toml").write_text(text, encoding="utf-8")
    refused(path, "check", tmp_path / "robot.toml")


def test_check_refuses_a_dbc_file_that_is_no_file(special, tmp_path):
    path = special("dbc-example.dbc")
    profile = tmp_path / "mine.toml"
    profile.write_bytes((DRIVES / "dbc-example.toml").read_bytes())
    refused(path, "drives", "--check", profile)


def test_a_secret_a_certificate_and_a_library_s_file_are_refused(special, tmp_path):
    path = special("secret")
    for read in (
        lambda: bounded.read(path),
        lambda: bounded.regular(path),
        lambda: tls_context("secret", "secret", lambda name: tmp_path / name),
    ):
        with pytest.raises(OSError, match="is not a regular file"):
            read()
    with pytest.raises((OSError, ValueError)):  # a device can be read by others
        read_secret(path)


@pytest.mark.parametrize("open_it", [StatePage.open, Journal.open])
def test_a_page_that_is_a_pipe_is_no_page(open_it):
    page = own_page("pipe")
    made = page if open_it == StatePage.open else page.with_suffix(".journal")
    made.parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(made)
    try:
        with pytest.raises((NoPage, NoJournal)):
            open_it("pipe")
    finally:
        made.unlink()
