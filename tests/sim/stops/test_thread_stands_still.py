# SPDX-License-Identifier: Apache-2.0
"""One thread of the daemon stands still while all others go on: the wheels come to rest, and the
supervisor's watchdog is not fed until the thread runs again.

Source: ptrace(2), PTRACE_SEIZE and PTRACE_INTERRUPT stop a single thread.
"""

import contextlib
import ctypes
import os
import time
from pathlib import Path

import pytest
from tests.sim.daemon_stage import running, set_off, wait_until
from tests.sim.supervised_daemon import PATIENCE_S, fed, notifications, supervised

LIBC = ctypes.CDLL(None, use_errno=True)
LIBC.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
LIBC.ptrace.restype = ctypes.c_long
DETACH, SEIZE, INTERRUPT = 17, 0x4206, 0x4207
WALL = 0x40000000
"""Option of waitpid(2) to wait for threads, too."""
WATCHED = {"loop": ("motord-loop", "the loop"), "line": ("motord-line", "line rs485")}


def ptrace(request, tid):
    if LIBC.ptrace(request, tid, None, None) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


@contextlib.contextmanager
def stands_still(pid, name):
    """Stop the thread with this name prefix, in a child of this process, until the block ends."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    (tid,) = [int(t.name) for t in tasks if (t / "comm").read_text().startswith(name)]
    try:
        ptrace(SEIZE, tid)
    except PermissionError:
        pytest.skip("ptrace is not allowed here")
    ptrace(INTERRUPT, tid)
    os.waitpid(tid, WALL)
    try:
        yield
    finally:
        ptrace(DETACH, tid)


@pytest.mark.parametrize("which", WATCHED)
def test_the_watchdog_is_not_fed_for_a_thread_that_stands_still(tmp_path, which):
    thread, heart = WATCHED[which]
    supervisor, environ = supervised(tmp_path)
    with supervisor, running(tmp_path, environ=environ) as stage:
        stage.wait_for("idle")
        set_off(stage)
        wait_until(lambda: fed(supervisor), "the watchdog is fed")
        with stands_still(stage.daemon.pid, thread):
            wait_until(lambda: f"{heart} has not moved" in stage.logged(), "it is missed")
            stage.wait_for("fault")
            wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
            notifications(supervisor)  # drop what was sent before
            silent_since_s = time.monotonic()
            wait_until(lambda: time.monotonic() - silent_since_s > PATIENCE_S, "the supervisor's")
            assert not fed(supervisor)
        wait_until(lambda: fed(supervisor), "it is fed again")
        assert stage.sim.truth().at_rest
