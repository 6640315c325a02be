# SPDX-License-Identifier: Apache-2.0
"""Runs a rig in real time, in one thread in select(), whose time-out has microseconds; that of
poll() and epoll has milliseconds.

Work that is due on a wire comes before the physics. With SCHED_FIFO, and a spin over the last
moment before work is due, the pace is that of a wire and not that of a scheduler.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from motord_hal.sim.rig import Rig
from motord_hal.sim.rs485.wire import Clock

WAIT_MAX_S = 0.02
"""Longest sleep. It limits how much physics is computed at once."""
SPIN_S = 0.0001
"""Time of spinning, longer than the wake-up of a SCHED_FIFO thread."""
PHYSICS_SPARE_S = 0.0005
"""The physics waits if work on a wire is due within this time."""
PHYSICS_LAG_MAX_S = 0.01
"""Greatest time for which the physics waits."""
HELD_UP_S = 0.002
"""Limit for a process without CPU. After a longer time, the clock of a robot that pauses advances
by this much only: so in the 5 ms between two looks of a line, a wheel turns no farther than it
can."""
NICE = -15
PUNCTUAL = "\0motord-simulator-on-time"
"""Name of a socket (unix(7), abstract) that exists while a simulator has SCHED_FIFO."""
TIMER_SLACK = Path("/proc/self/timerslack_ns")


def set_pace(priority: int) -> None:
    """Set the pace of a process that does nothing else: wake-ups without slack (50 µs by default:
    prctl(2), PR_SET_TIMERSLACK), and short garbage collections. With a priority it gets SCHED_FIFO,
    else it goes ahead of other programs if that is allowed: hardware does not wait for a CPU.
    Raises PermissionError if the priority is not allowed."""
    with contextlib.suppress(OSError):  # older kernels and sandboxes: the default slack stays
        TIMER_SLACK.write_text("1")
    if priority > 0:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    else:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
    gc.collect()
    gc.freeze()  # present objects stay: later collections have little to examine


@contextlib.contextmanager
def punctual() -> Iterator[bool]:
    """Yield whether a simulator may have SCHED_FIFO meanwhile: it is allowed, a processor is left
    for others, and no other simulator of this machine has it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as place:
        try:
            place.bind(PUNCTUAL)
            free = True
        except OSError:
            free = False
        yield free and _may_be_punctual()


def _may_be_punctual() -> bool:
    granted: list[bool] = []

    def ask() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
            granted.append(True)
        except OSError:
            granted.append(False)

    asking = threading.Thread(target=ask)  # the policy is a thread's and ends with it
    asking.start()
    asking.join()
    return granted[0] and len(os.sched_getaffinity(0)) > 1


def run(
    rig: Rig,
    stopped: Callable[[], bool],
    until_fd_ends: int | None = None,
    *,
    spin_s: float = 0.0,
) -> None:
    """Run the robot until `stopped()` or until that file descriptor ends. `spin_s`: time before due
    work in which the thread does not sleep."""
    rig.began_ns = time.monotonic_ns() - round(rig.plant.time_s * 1e9)
    began_s = rig.began_ns * 1e-9
    clock = PausingClock(began_s) if rig.pauses else lambda: time.monotonic() - began_s
    _Runner(rig, clock, until_fd_ends, spin_s).run(stopped)


class PausingClock:
    """Seconds since `began_s`, without those in which nothing could be requested."""

    def __init__(self, began_s: float, now_s: Clock = time.monotonic) -> None:
        self._began_s = began_s
        self._now_s = now_s
        self._last_s = now_s() - began_s

    def __call__(self) -> float:
        at_s = self._now_s() - self._began_s
        paused_s = max(0.0, at_s - self._last_s - HELD_UP_S)
        self._began_s += paused_s
        self._last_s = at_s - paused_s
        return self._last_s


class _Runner:
    def __init__(self, rig: Rig, clock: Clock, until_fd_ends: int | None, spin_s: float) -> None:
        self._rig = rig
        self._clock = clock
        self._watched = [] if until_fd_ends is None else [until_fd_ends]
        self._spin_s = spin_s
        self._woke_s = time.monotonic()

    def run(self, stopped: Callable[[], bool]) -> None:
        rig, clock = self._rig, self._clock
        while not stopped():
            ready = set(self._wait())
            rig.work_lines(clock)
            if ready:
                rig.server.work(ready)
            self._advance()
            if ready & set(self._watched) and not os.read(self._watched[0], 4096):
                return

    def _wait(self) -> list[int]:
        rig, clock = self._rig, self._clock
        now_s = clock()
        due_s = rig.due_s(now_s)
        files = [*rig.filenos(now_s), *self._watched]
        wait_s = max(0.0, min(due_s - self._spin_s - now_s, WAIT_MAX_S))
        ready = select.select(files, [], [], wait_s)[0]
        woke_s = time.monotonic()
        rig.held_up_max_s = max(rig.held_up_max_s, woke_s - self._woke_s - wait_s)
        self._woke_s = woke_s
        if self._spin_s > 0.0 and not ready:
            while (left_s := due_s - clock()) > 0.0 and left_s <= self._spin_s:
                pass
        return ready

    def _advance(self) -> None:
        """Compute the physics up to now, as far as the wires leave time."""
        rig, clock = self._rig, self._clock
        due_s = rig.due_s(clock())
        while rig.substep_due(now_s := clock()):
            behind_s = now_s - rig.plant.time_s
            if due_s - now_s < PHYSICS_SPARE_S and behind_s < PHYSICS_LAG_MAX_S:
                return
            rig.substep()
