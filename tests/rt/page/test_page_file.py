# SPDX-License-Identifier: Apache-2.0
"""Ownership of the state page's file: one process holds it."""

import contextlib
import os
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from motord.api import page_file
from motord.api.page_file import PageFile, PageInUse, find_page

PAGE_BYTES = 16384
HOLDER = """
import sys
from pathlib import Path
from motord.api import page_file
page_file.SHARED = Path(sys.argv[1])
held = page_file.PageFile.open("robot")
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def shared(tmp_path, monkeypatch):
    """Stands for /dev/shm: every user may make files, and no user may remove those of others."""
    monkeypatch.setattr(page_file, "SHARED", tmp_path)
    open_to_others(tmp_path)
    tmp_path.chmod(0o1777)
    return tmp_path


@pytest.fixture
def folder(shared):
    """The folder of this user in `shared`."""
    found = shared / f"motord-{os.geteuid()}"
    found.mkdir(mode=0o755)
    return found


@pytest.fixture
def holder(shared):
    """A process that holds the page of `robot`, as a living daemon does."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(shared)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
    ) as process:
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()


def test_every_reader_can_open_the_file_until_it_is_closed(shared):
    page = PageFile.open("robot")
    path = shared / f"motord-{os.geteuid()}" / "robot.page"
    assert page.path == path == find_page("robot")
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o755
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert not os.get_inheritable(page.fd)
    page.close()
    page.close()
    assert not path.parent.exists()


def test_readers_can_open_the_file_with_any_umask():
    before = os.umask(0o077)
    try:
        page = PageFile.open("robot")
    finally:
        os.umask(before)
    assert stat.S_IMODE(page.path.stat().st_mode) == 0o644
    assert stat.S_IMODE(page.path.parent.stat().st_mode) == 0o755
    page.close()


def test_the_page_of_a_living_daemon_is_refused(holder):
    with pytest.raises(PageInUse, match="living daemon"):
        PageFile.open("robot")
    assert find_page("robot").exists()


def test_the_page_of_a_killed_daemon_is_taken_over_in_place(holder):
    with open(find_page("robot"), "rb") as attached:
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


def test_a_file_that_another_program_has_replaced_is_not_removed():
    page = PageFile.open("robot")
    page.path.unlink()
    page.path.write_text("another's")
    page.close()
    assert page.path.read_text() == "another's"


def test_a_link_is_not_followed(folder):
    (folder / "precious").write_text("kept")
    (folder / "robot.page").symlink_to(folder / "precious")
    with PageFile.open("robot") as page:
        assert not page.path.is_symlink()
        os.pwrite(page.fd, b"page", 0)
    assert (folder / "precious").read_text() == "kept"


@pytest.mark.parametrize("name", ["", "../passwd", "a/b", "nul\0"])
def test_a_name_that_is_not_a_file_name_is_refused(name):
    with pytest.raises(ValueError, match="file name"):
        PageFile.open(name)


def open_to_others(folder):
    """Let other users reach `folder`: open the folders above it up to the temporary one."""
    for above in folder.parents:
        if above == Path(tempfile.gettempdir()):
            return
        above.chmod(0o755)


STRANGER = """
import fcntl, os, struct, sys
path, deed = sys.argv[1:]
if os.getuid() == 0:
    os.setuid(65534)
if deed == "makes the folder":
    os.mkdir(os.path.dirname(path))
if deed.startswith("makes"):
    fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    os.fchmod(fd, 0o666)
    os.ftruncate(fd, 1 << 20)
else:
    fd = os.open(path, os.O_RDONLY)
    if deed == "locks":
        fcntl.flock(fd, fcntl.LOCK_SH)
    if deed == "locks for reading":
        lock = struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0)
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, lock)
print("done", flush=True)
sys.stdin.read()
if deed.startswith("makes"):
    os.ftruncate(fd, 0)
    print("shorter", flush=True)
"""


@contextlib.contextmanager
def stranger(path, deed):
    with subprocess.Popen(
        [sys.executable, "-c", STRANGER, str(path), deed],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        try:
            assert process.stdout.readline() == b"done\n"
            yield process
        finally:
            process.kill()


def test_a_folder_made_by_a_stranger_blocks_nothing_and_is_not_read(shared):
    """Without root the stranger is a process of this user, with a folder open to all writers."""
    taken = shared / f"motord-{os.geteuid()}"
    with stranger(taken / "robot.page", "makes the folder") as process:
        if os.geteuid() != 0:
            taken.chmod(0o777)
        with PageFile.open("robot") as page:
            os.posix_fallocate(page.fd, 0, PAGE_BYTES)
            process.stdin.close()
            assert process.stdout.readline() == b"shorter\n"
            info = os.fstat(page.fd)
            assert (info.st_size, info.st_uid) == (PAGE_BYTES, os.geteuid())
            assert os.path.samestat(find_page("robot").stat(), info)
            assert page.path.parent != taken
            with pytest.raises(PageInUse, match="living daemon"):
                PageFile.open("robot")


def test_no_other_user_can_write_in_the_folder():
    with PageFile.open("robot") as page:
        info = page.path.parent.stat()
        assert info.st_uid == os.geteuid()
        assert not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@pytest.mark.parametrize("deed", ["locks", "locks for reading"])
def test_a_reader_s_lock_on_a_dead_daemon_s_page_blocks_nothing(folder, deed):
    path = folder / "robot.page"
    path.touch(0o644)
    with stranger(path, deed), PageFile.open("robot") as page:
        assert os.path.samestat(path.stat(), os.fstat(page.fd))


def test_a_reader_s_lock_does_not_take_the_page_of_a_living_daemon(holder):
    with stranger(find_page("robot"), "looks"), pytest.raises(PageInUse, match="living daemon"):
        PageFile.open("robot")


@pytest.mark.parametrize("kind", ["fifo", "others write", "second name"])
def test_a_page_that_is_not_a_private_plain_file_of_this_user_is_replaced(folder, kind):
    path = folder / "robot.page"
    if kind == "fifo":
        os.mkfifo(path)
    else:
        path.touch()
        path.chmod(0o666 if kind == "others write" else 0o644)
    if kind == "second name":
        os.link(path, path.with_name("second"))
    before = os.open(path, os.O_PATH)  # while it is open, its inode number is not reused
    with PageFile.open("robot") as page:
        assert stat.S_IMODE(path.lstat().st_mode) == 0o644
        assert stat.S_ISREG(os.fstat(page.fd).st_mode)
        assert not os.path.samestat(os.fstat(before), os.fstat(page.fd))
    os.close(before)
