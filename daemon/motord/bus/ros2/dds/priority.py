# SPDX-License-Identifier: Apache-2.0
"""Gives the receiving thread of Cyclone DDS, which takes a cmd_vel from the network to the daemon,
priority over Python: SCHED_FIFO at the lowest priority there is, if the system permits it. The
daemon's threads have higher priorities.

Without it the thread, once woken, waits for a busy Python thread to use up its slice: up to one
tick of the kernel, 4 ms at 250 Hz, in one of ten commands (docs/performance.md).

A thread that runs for REALTIME_RUNS_MAX_US without a pause is flooded: it gets ordinary scheduling
again. Sources: motord.bus.confine, sched(7).
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from motord.bus.confine import REALTIME_PRIORITY_MAX, REALTIME_RUNS_MAX_US

_BEFORE_PYTHON = "recv"
"""Beginning of the threads' names: recv, or recvMC and recvUC."""

_log = logging.getLogger(__name__)


def _threads(process: int | str) -> Iterator[int]:
    for task in Path(f"/proc/{process}/task").iterdir():
        with suppress(OSError):  # it has ended meanwhile
            if (task / "comm").read_text(encoding="ascii").startswith(_BEFORE_PYTHON):
                yield int(task.name)


def set_policy(policy: int, priority: int, process: int | str = "self") -> None:
    """Set the scheduling policy of the receiving threads of a process. A thread stays as it is if
    the system does not permit the change."""
    for thread in _threads(process):
        with suppress(OSError):
            os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _flooded() -> None:
    set_policy(os.SCHED_OTHER, 0)
    _log.warning(
        "DDS receives so much that its thread ran for %d ms without a pause: it loses its real-time"
        " priority until motord-bus starts again, and its commands may wait for Python",
        REALTIME_RUNS_MAX_US // 1000,
    )


def before_python() -> None:
    """Give the receiving threads that exist now priority over Python. The event loop that calls
    this handles a flood."""
    asyncio.get_running_loop().add_signal_handler(signal.SIGXCPU, _flooded)
    set_policy(os.SCHED_FIFO, REALTIME_PRIORITY_MAX)
