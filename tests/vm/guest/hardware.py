# SPDX-License-Identifier: Apache-2.0
"""What stands for hardware here runs before all that does not: drives and cables do not
wait until the computer is done with its other work.

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
    """A thread, from now on, and those that it starts; 0: this one."""
    os.sched_setscheduler(thread, os.SCHED_RR, os.sched_param(PRIORITY))


@contextlib.contextmanager
def simulated(robot, **options):
    """The drives of a robot file, a process of their own; yields the simulator."""
    with start_simulator(robot, timeout_s=DEADLINE_S, **options) as simulator:
        for thread in Path(f"/proc/{simulator.process.pid}/task").iterdir():
            run_first(int(thread.name))
        yield simulator
