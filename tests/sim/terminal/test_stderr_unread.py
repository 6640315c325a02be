# SPDX-License-Identifier: Apache-2.0
"""No program reads the daemon's stderr: it still starts and follows commands."""

import os

import pytest
from tests.sim.daemon_stage import running

NEVER_REACHED = "limits.linear_m_s=1.3"
"""Setting that causes a warning at the start."""
CLOSING = """
import os, sys
os.close(2)
os.execv(sys.executable, [sys.executable, "-m", "motord", *sys.argv[1:]])
"""


def full_pipe():
    """Return both ends of a full pipe, on which a write blocks."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, bytes(4096))
    except BlockingIOError:
        os.set_blocking(writing, True)
    return reading, writing


@pytest.mark.parametrize("how", ["full pipe", "full disk", "closed"])
def test_the_daemon_starts_and_ends(tmp_path, how):
    ends = full_pipe() if how == "full pipe" else (os.open("/dev/full", os.O_WRONLY),)
    try:
        motord = ("-c", CLOSING) if how == "closed" else ("-m", "motord")
        with running(tmp_path, NEVER_REACHED, motord=motord, stderr=ends[-1]) as stage:
            stage.wait_for("idle")
            assert stage.robot.estop() == "estop"
            assert stage.end() == 0
    finally:
        for fd in ends:
            os.close(fd)
