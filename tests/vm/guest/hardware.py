# SPDX-License-Identifier: Apache-2.0
"""Processes that stand for hardware run before all others here: real drives and cables do not wait
for the computer's other work.

Source: sched(7).
"""

import contextlib
import os
from pathlib import Path

from shell import DEADLINE_S

from motord.tools.simulator import start_simulator

PRIORITY = 20
"""Below the daemon's threads and the kernel's interrupts."""


def run_first(thread=0):
    """Gives a thread, and those that it starts, this priority from now on; 0: this thread."""
    os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(PRIORITY))


@contextlib.contextmanager
def simulated(robot, **options):
    """The drives of a robot file, a process of their own; yields the simulator."""
    with start_simulator(robot, timeout_s=DEADLINE_S, **options) as simulator:
        for thread in Path(f"/proc/{simulator.process.pid}/task").iterdir():
            run_first(int(thread.name))
        yield simulator
