# SPDX-License-Identifier: Apache-2.0
"""Ends a daemon that hangs, so that its drives can be stopped without it.

Only the process that holds the lock on the robot's state page is ended, and only if it belongs to
the page's owner: a process number in a file may be that of another process by now."""

from __future__ import annotations

import errno
import os
import select
import signal
import time
from pathlib import Path

from motord.api.page_file import find_page, writer_lives, writer_pid
from motord.api.state_page import NoPage, StatePage
from motord.api.stop_request import LOOK_EVERY_S, Hang, Standstill
from motord.tools.stop_all import DaemonRuns

DEAD_AFTER_S = 0.5
"""Time since the last tick after which a daemon is ended. After this time the daemon itself reports
its loop (LOOP_WITHIN_S), and systemd gets no sign of life any more."""
JUDGED_WITHIN_S = 3.0
ENDS_WITHIN_S = 2.0
"""Time for the kernel to end the process, which may wait for a device."""


def hang_of(robot: str) -> Hang | None:
    """Return how the daemon of this robot hangs. None: no daemon lives. Raises DaemonRuns if it
    ticks, or if nothing shows that it hangs."""
    path = find_page(robot)
    if not writer_lives(path):
        return None
    why = f"the daemon of {robot} runs ({path}): use motord estop"
    try:
        with StatePage.open(robot, owner=path.stat().st_uid) as page:
            now_s = time.monotonic()
            standstill, end_s = Standstill(page, now_s), now_s + JUDGED_WITHIN_S
            while not standstill.ticked and now_s < end_s:
                if hang := standstill.hang():
                    return hang
                time.sleep(LOOK_EVERY_S)
                standstill.look(now_s := time.monotonic())
    except (NoPage, OSError) as error:
        why = f"the daemon of {robot} runs, but shows no state: {error}"
    if not writer_lives(path):
        return None
    raise DaemonRuns(why)


def end(hang: Hang) -> None:
    """End the process of a daemon that hangs by SIGKILL, DEAD_AFTER_S after its last tick, and wait
    for its end. Raises DaemonRuns, also if it has ticked since."""
    time.sleep(max(DEAD_AFTER_S - (time.monotonic_ns() - hang.stamp_ns) * 1e-9, 0.0))
    if hang.pid is None:
        raise DaemonRuns(f"{hang}: end it as root or as the user who started it")
    try:
        process = os.pidfd_open(hang.pid)
    except ProcessLookupError:
        _check_gone(hang)
        return
    try:
        # with this descriptor open, the number stays that of the process that gets the signal
        if not _is_its_process(hang) or not _stands_still(hang):
            _check_gone(hang)
            return
        signal.pidfd_send_signal(process, signal.SIGKILL)
        ended = select.poll()
        ended.register(process, select.POLLIN)
        if not ended.poll(ENDS_WITHIN_S * 1000.0):
            raise DaemonRuns(f"process {hang.pid} does not end: cut the power by hand")
    except ProcessLookupError:
        _check_gone(hang)
    except PermissionError:
        raise DaemonRuns(f"{hang}, and this user may not end it: run this with sudo") from None
    except OSError as error:
        raise DaemonRuns(f"{hang}, and cannot be ended: {error}") from None
    finally:
        os.close(process)


def _check_gone(hang: Hang) -> None:
    """Raise DaemonRuns if a daemon holds the page."""
    if writer_lives(hang.page):
        raise DaemonRuns(
            f"the daemon of {hang.robot} has ticked since, or is another process: motord estop"
        )


def _is_its_process(hang: Hang) -> bool:
    """Whether the process has locked the page, and belongs to its owner."""
    assert hang.pid is not None
    return writer_pid(hang.page) == hang.pid and _user_of(hang.pid) == hang.page.stat().st_uid


def _stands_still(hang: Hang) -> bool:
    """Whether the page shows no newer tick. Raises OSError."""
    try:
        with StatePage.open(hang.robot, owner=hang.page.stat().st_uid) as page:
            newest = page.read()
    except NoPage:
        return False
    return newest is not None and newest.stamp_ns == hang.stamp_ns


def _user_of(pid: int) -> int:
    """Return the effective user of a process (proc_pid_status(5)). Raises OSError."""
    for line in Path(f"/proc/{pid}/status").read_text("utf-8", errors="replace").splitlines():
        name, *numbers = line.split()
        if name == "Uid:":
            return int(numbers[1])
    raise ProcessLookupError(errno.ESRCH, os.strerror(errno.ESRCH))
