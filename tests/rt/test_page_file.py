# SPDX-License-Identifier: Apache-2.0
"""Whose the file of the state page is."""

import os
import signal
import stat
import subprocess
import sys

import pytest

from motord import page_file
from motord.page_file import PageFile, PageInUse

HOLDER = """
import sys
from pathlib import Path
from motord import page_file
page_file.FOLDER = Path(sys.argv[1])
held = page_file.PageFile.open("robot")
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(page_file, "FOLDER", tmp_path)
    return tmp_path


@pytest.fixture
def holder(folder):
    """A daemon that lives and holds the page of `robot`."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
    ) as process:
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()


def test_the_file_is_there_for_every_reader_until_it_is_closed(folder):
    page = PageFile.open("robot")
    path = folder / "motord-robot"
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert not os.get_inheritable(page.fd)
    page.close()
    page.close()
    assert not path.exists()


def test_readers_get_in_whatever_the_umask(folder):
    before = os.umask(0o077)
    try:
        page = PageFile.open("robot")
    finally:
        os.umask(before)
    assert stat.S_IMODE(page.path.stat().st_mode) == 0o644
    page.close()


def test_the_page_of_a_living_daemon_is_refused(holder, folder):
    with pytest.raises(PageInUse, match="living daemon"):
        PageFile.open("robot")
    assert (folder / "motord-robot").exists()


def test_the_page_of_a_killed_daemon_is_taken_over_in_place(holder, folder):
    with open(folder / "motord-robot", "rb") as attached:
        holder.send_signal(signal.SIGKILL)
        holder.wait(timeout=30)
        page = PageFile.open("robot")
        assert os.path.samestat(os.fstat(attached.fileno()), os.fstat(page.fd))
    page.close()


def test_the_refusal_names_the_process_that_the_header_names():
    page = PageFile.open("robot")
    os.pwrite(page.fd, (4711).to_bytes(4, sys.byteorder), 28)
    with pytest.raises(PageInUse, match="process 4711"):
        PageFile.open("robot")
    page.close()


def test_a_file_that_is_somebody_elses_by_now_is_left_alone(folder):
    page = PageFile.open("robot")
    page.path.unlink()
    page.path.write_text("another's")
    page.close()
    assert page.path.read_text() == "another's"


def test_a_link_is_not_followed(folder):
    (folder / "precious").write_text("kept")
    (folder / "motord-robot").symlink_to(folder / "precious")
    with pytest.raises(OSError, match="motord-robot"):
        PageFile.open("robot")
    assert (folder / "precious").read_text() == "kept"


@pytest.mark.parametrize("name", ["", "../passwd", "a/b", "nul\0"])
def test_a_name_that_is_no_file_name_is_refused(name):
    with pytest.raises(ValueError, match="file name"):
        PageFile.open(name)


OTHER_USER = """
import os, sys
from pathlib import Path
from motord import page_file
page_file.FOLDER = Path(sys.argv[1])
if os.getuid() == 0:
    os.setuid(65534)
try:
    page_file.PageFile.open("robot")
except page_file.PageInUse as error:
    print(error)
"""


def test_a_file_that_belongs_to_another_user_is_said_to_be_so(tmp_path):
    """Root's own file in the eyes of nobody; without root, a file that may not be written."""
    path = tmp_path / "motord-robot"
    path.touch(0o444)
    for folder in (tmp_path, *tmp_path.parents[:2]):
        folder.chmod(0o755)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    said = subprocess.run(
        [sys.executable, "-c", OTHER_USER, str(tmp_path)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=30,
    )
    assert f"{path} belongs to another user" in said.stdout, said.stderr
