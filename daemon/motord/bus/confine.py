# SPDX-License-Identifier: Apache-2.0
"""Restricts the second process at its start, so that it cannot disturb the robot: it gives up
capabilities, all real-time priorities but the lowest, unlimited memory, and part of its share of
the processor."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import struct
from pathlib import Path

DATA_BYTES_MAX = 512 << 20
"""Largest private memory, including stacks of threads: a leak ends the process here, and the daemon
starts it again."""
NICENESS = 5
REALTIME_PRIORITY_MAX = 1
"""The lowest real-time priority, for the threads that motord.bus.ros2.dds.priority names, if the
system permits any."""
REALTIME_RUNS_MAX_US, REALTIME_KILLED_AFTER_US = 50_000, 2_000_000
"""How long a real-time thread may run without a pause. Then the process gets SIGXCPU, which ends it
unless it handles the signal, and at last SIGKILL. Source: RLIMIT_RTTIME in getrlimit(2)."""
_OOM_SCORE_ADJ = 500
"""Makes the kernel end this process before the daemon when memory runs out:
proc_pid_oom_score_adj(5)."""
_PR_SET_NO_NEW_PRIVS, _PR_CAP_AMBIENT, _PR_CAP_AMBIENT_CLEAR_ALL = 38, 47, 4
"""include/uapi/linux/prctl.h"""
_CAPABILITY_VERSION_3 = 0x20080522
"""include/uapi/linux/capability.h"""


def confine() -> None:
    """Restrict this process. Call it once, before anything else. A step that the kernel refuses is
    left out: each one only gives something up."""
    limit_realtime()
    _drop_capabilities()
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = DATA_BYTES_MAX if hard == resource.RLIM_INFINITY else min(DATA_BYTES_MAX, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(_OOM_SCORE_ADJ), encoding="ascii")


def limit_realtime() -> None:
    """Permit only the lowest real-time priority, and only for a short time: no adapter can keep the
    daemon waiting."""
    with contextlib.suppress(OSError, ValueError):  # not permitted: it is 0
        resource.setrlimit(resource.RLIMIT_RTPRIO, (REALTIME_PRIORITY_MAX, REALTIME_PRIORITY_MAX))
    _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    killed_us = REALTIME_KILLED_AFTER_US
    killed_us = killed_us if hard == resource.RLIM_INFINITY else min(hard, killed_us)
    runs_us = min(REALTIME_RUNS_MAX_US, killed_us)
    resource.setrlimit(resource.RLIMIT_RTTIME, (runs_us, killed_us))


def _drop_capabilities() -> None:
    """Empty all sets of capabilities, also for every program that is started later:
    capabilities(7)."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    libc.prctl(_PR_CAP_AMBIENT, _PR_CAP_AMBIENT_CLEAR_ALL, 0, 0, 0)
    header = struct.pack("=Ii", _CAPABILITY_VERSION_3, 0)
    libc.capset(header, bytes(struct.calcsize("=6I")))
