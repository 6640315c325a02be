# SPDX-License-Identifier: Apache-2.0
"""Which process is ended when a daemon hangs: the one that holds the page of this robot, and no
other, whatever numbers the page contains."""

import fcntl
import os
import signal
import struct
import subprocess
import sys
import uuid
from pathlib import Path

import pytest

from motord.api.page_file import find_page, own_page
from motord.api.state_page import StatePage
from motord.api.stop_request import LOOK_COUNTS_S, STANDS_STILL_S, Standstill
from motord.tools.hung_daemon import end, hang_of
from motord.tools.stop_all import DaemonRuns

WRITER = str(Path(__file__).with_name("page_writer.py"))
PID_OFFSET = 28
NOBODY = 65534


class Writer:
    """A process that owns a page and ticks when it is asked to."""

    def __init__(self, name, *user):
        self.process = subprocess.Popen(
            [sys.executable, WRITER, name, *user],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout.readline() == "there\n"

    def tick(self):
        self.process.stdin.write("\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "written\n"

    @property
    def lives(self):
        return self.process.poll() is None

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture
def name():
    name = f"t{uuid.uuid4().hex[:12]}"
    yield name
    own_page(name).unlink(missing_ok=True)


@pytest.fixture
def started(name):
    """Start a writer of the page."""
    writers = []

    def start(*user):
        writers.append(Writer(name, *user))
        return writers[-1]

    yield start
    for writer in writers:
        writer.kill()


@pytest.fixture
def bystander():
    process = subprocess.Popen(["sleep", "600"])
    yield process
    process.kill()
    process.wait()


def put_pid(name, pid):
    with find_page(name).open("r+b") as file:
        os.pwrite(file.fileno(), struct.pack("=I", pid), PID_OFFSET)


def test_the_process_that_holds_the_page_is_ended(name, started, bystander):
    writer = started()
    writer.tick()
    put_pid(name, bystander.pid)
    hang = hang_of(name)
    assert (hang.pid, hang.robot) == (writer.process.pid, name)
    end(hang)
    assert writer.process.wait(60) == -signal.SIGKILL
    assert bystander.poll() is None


def test_no_process_is_ended_for_the_page_of_a_dead_daemon(name, started, bystander):
    writer = started()
    writer.tick()
    writer.process.kill()
    writer.process.wait()
    put_pid(name, bystander.pid)
    assert hang_of(name) is None
    with find_page(name).open("rb") as reader:  # any user can lock what it can read
        fcntl.flock(reader, fcntl.LOCK_EX)
        assert hang_of(name) is None


def test_a_daemon_that_died_since_is_not_ended_again(name, started):
    writer = started()
    writer.tick()
    hang = hang_of(name)
    writer.process.kill()
    writer.process.wait()
    end(hang)


def test_a_daemon_that_ticked_since_is_not_ended(name, started):
    writer = started()
    writer.tick()
    hang = hang_of(name)
    writer.tick()
    with pytest.raises(DaemonRuns, match="has ticked since"):
        end(hang)
    assert writer.lives


def test_the_next_daemon_is_not_ended_in_place_of_the_one_that_hung(name, started):
    first = started()
    first.tick()
    hang = hang_of(name)
    first.process.kill()
    first.process.wait()
    second = started()
    second.tick()
    with pytest.raises(DaemonRuns):
        end(hang)
    assert second.lives


def test_a_daemon_that_has_not_ticked_yet_is_starting(name, started):
    writer = started()
    with pytest.raises(DaemonRuns, match="runs"):
        hang_of(name)
    assert writer.lives


@pytest.mark.skipif(os.geteuid() != 0, reason="it takes root to become another user")
def test_a_process_of_another_user_than_the_page_is_not_ended(name, started):
    writer = started(str(NOBODY))
    writer.tick()
    with pytest.raises(DaemonRuns):
        end(hang_of(name))
    assert writer.lives


def test_time_in_which_the_observer_stood_still_does_not_count(name, started):
    writer = started()
    writer.tick()
    with StatePage.open(name) as page:
        standstill, now_s = Standstill(page, 0.0), 0.0
        for _ in range(int(STANDS_STILL_S / LOOK_COUNTS_S) - 1):
            now_s += 10.0
            standstill.look(now_s)
        assert standstill.hang() is None
        writer.tick()
        standstill.look(now_s)
        assert standstill.ticked
        for _ in range(int(STANDS_STILL_S / LOOK_COUNTS_S) + 1):
            assert standstill.hang() is None
            now_s += LOOK_COUNTS_S
            standstill.look(now_s)
        assert standstill.is_still
