# SPDX-License-Identifier: Apache-2.0
"""The log, as the journal receives it on its socket and as it arrives on stderr."""

import contextlib
import os
import socket
import struct
import subprocess
import sys

import pytest

PROGRAM = """
import logging, os, sys
from pathlib import Path
from motord.base import log
info = os.fstat(2)
stream = f"{info.st_dev}:{info.st_ino}" if sys.argv[2] == "same" else "1:1"
log.set_up({"JOURNAL_STREAM": stream}, Path(sys.argv[1]))
event = "drive_unresponsive"
about_line = log.about(line="rs485", joints=("left", "right"), event=event, faults=("dead",))
logging.getLogger("x").warning(sys.argv[3], extra=about_line)
"""


@pytest.fixture
def journal(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "journal"))
        listener.settimeout(30.0)
        yield listener


def logged(journal, text, stream="same"):
    """Return the stderr of a process that logs `text` as a warning."""
    command = [sys.executable, "-c", PROGRAM, journal.getsockname(), stream, text]
    return subprocess.run(command, stderr=subprocess.PIPE, check=True, timeout=30).stderr.decode()


def test_the_journal_gets_a_warning_with_line_event_and_joints(journal):
    assert logged(journal, "the drive is unresponsive") == ""
    assert journal.recv(9999).decode().splitlines() == [
        "MESSAGE=the drive is unresponsive",
        "PRIORITY=4",
        "SYSLOG_IDENTIFIER=motord",
        "MOTORD_LINE=rs485",
        "MOTORD_EVENT=drive_unresponsive",
        "MOTORD_JOINT=left",
        "MOTORD_JOINT=right",
        "MOTORD_FAULT=dead",
    ]


def test_a_message_of_several_lines_stays_one_entry(journal):
    logged(journal, "one\ntwo=2")
    head = b"MESSAGE\n" + struct.pack("<Q", 9) + b"one\ntwo=2\nPRIORITY=4\n"
    assert journal.recv(9999).startswith(head)


def test_a_stderr_that_is_not_the_journals_gets_plain_lines_with_the_time(journal):
    assert logged(journal, "the drive is unresponsive", "other").endswith(
        "WARNING the drive is unresponsive\n"
    )


def test_a_missing_journal_stops_nothing(journal):
    path = journal.getsockname()
    os.unlink(path)
    assert logged(journal, "this is not read") == ""


TWO_LINES = """
import logging, os, sys, time
from motord.base import log
log.set_up({})
logger = logging.getLogger("x")
logger.warning("lost")
while not logging.getLogger().handlers[0]._lost:
    time.sleep(0.001)
print("lost", flush=True)
sys.stdin.readline()
logger.warning("%d of them", "no number")
logger.warning("received")
"""


def test_a_full_stderr_loses_lines_and_counts_them(tmp_path):
    """The pipe is full, is not read and does not block: lines that find no room are counted."""
    reading, writing = os.pipe2(os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    command = [sys.executable, "-c", TWO_LINES]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=writing) as process:
        os.close(writing)
        assert process.stdout.readline() == b"lost\n"
        with contextlib.suppress(BlockingIOError):
            while os.read(reading, 1 << 16):
                pass
        process.stdin.close()
        assert process.wait(30) == 0
    with open(reading, "rb") as rest:
        text = rest.read().lstrip(b"\0").decode()
    assert "lines of the log were lost before this one" in text
    assert "cannot be logged: %d format" in text
    assert text.endswith("WARNING received\n")
