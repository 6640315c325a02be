# SPDX-License-Identifier: Apache-2.0
"""The thread that takes a cmd_vel from the network to the daemon runs before Python: the receiving
thread of Cyclone DDS gets SCHED_FIFO at the lowest priority there is, where the system grants it.
The daemon's threads have higher ones.

Without it the thread, once woken, waits for a busy Python thread to use up its slice: up to one
tick of the kernel, 4 ms at 250 Hz, in one of ten commands (docs/performance.md).

A thread that runs for RUNS_MAX_US without a pause is flooded: it takes turns with the others
again. Source: RLIMIT_RTTIME in getrlimit(2), sched(7).
"""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

PRIORITY = 1
RUNS_MAX_US, KILLED_AFTER_US = 50_000, 2_000_000
_BEFORE_PYTHON = "recv"
"""How the names of the threads begin: recv, or recvMC and recvUC."""

_log = logging.getLogger(__name__)


def _threads(process: int | str) -> Iterator[int]:
    for task in Path(f"/proc/{process}/task").iterdir():
        with suppress(OSError):  # it has ended meanwhile
            if (task / "comm").read_text(encoding="ascii").startswith(_BEFORE_PYTHON):
                yield int(task.name)


def give(policy: int, priority: int, process: int | str = "self") -> None:
    """To these threads of a process; what is not granted stays as it is."""
    for thread in _threads(process):
        with suppress(OSError):
            os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _flooded() -> None:
    give(os.SCHED_OTHER, 0)
    _log.warning(
        "DDS brings so much that a thread did not pause for %d ms: commands from it take turns"
        " with Python from now on, until motord-bus starts again",
        RUNS_MAX_US // 1000,
    )


def before_python() -> None:
    """For the threads that there are now. The event loop that calls it handles a flood."""
    asyncio.get_running_loop().add_signal_handler(signal.SIGXCPU, _flooded)
    _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    longest = KILLED_AFTER_US if hard == resource.RLIM_INFINITY else min(hard, KILLED_AFTER_US)
    resource.setrlimit(resource.RLIMIT_RTTIME, (min(RUNS_MAX_US, longest), longest))
    give(os.SCHED_FIFO, PRIORITY)
