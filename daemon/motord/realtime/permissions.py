# SPDX-License-Identifier: Apache-2.0
"""Sentences about what the kernel refused the real-time thread: the reason, the effect, and what
the user can do about it."""

from __future__ import annotations

import errno
import resource
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_CAP_SYS_NICE = 23
"""Number of the capability in include/uapi/linux/capability.h."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """The errno of each request to the kernel; 0: granted, or not requested."""

    scheduler: int = 0
    affinity: int = 0
    memory_lock: int = 0
    dma_latency: int = 0


def sentences(refused: Refused, *, priority: int, cpu: Sequence[int]) -> dict[str, str]:
    """Return refused thing → sentence; empty if everything was granted."""
    found: dict[str, str] = {}
    if refused.scheduler:
        found["scheduler"] = (
            f"SCHED_FIFO priority {priority} was refused ({_name(refused.scheduler)}): the loop"
            " runs SCHED_OTHER and is late whenever the machine is busy;"
            f" {_scheduler_cure(priority)}"
        )
    if refused.affinity:
        numbers = ", ".join(str(number) for number in cpu)
        found["affinity"] = (
            f"the loop could not be bound to CPU {numbers} ({_name(refused.affinity)}): it runs on"
            " any; name CPUs in [loop] cpu that exist and that the process's cpuset allows"
        )
    if refused.memory_lock:
        found["memory_lock"] = (
            f"memory was not locked ({_name(refused.memory_lock)}, RLIMIT_MEMLOCK {_memlock()}): a"
            " page that is swapped out stops the loop; LimitMEMLOCK=infinity in the unit,"
            " `memlock unlimited` in /etc/security/limits.d, or CAP_IPC_LOCK"
        )
    if refused.dma_latency:
        found["dma_latency"] = (
            f"/dev/cpu_dma_latency could not be held ({_name(refused.dma_latency)}): the CPU may"
            " sleep deeply and wake the loop some 100 us late; give the user write access by a"
            " udev rule"
        )
    return found


def _scheduler_cure(priority: int) -> str:
    """Return what the user can do, by which of the kernel's two reasons for a refusal applies
    (sched(7))."""
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    if limit >= priority or _has_capability(_CAP_SYS_NICE):
        return (
            "the user may have it, so its control group has no real-time budget (RT_GROUP_SCHED):"
            " set cpu.rt_runtime_us of the group, or boot with rt_group_sched=0"
        )
    return (
        f"RLIMIT_RTPRIO is {limit}: LimitRTPRIO={priority} in the unit, `rtprio {priority}` in"
        " /etc/security/limits.d, or CAP_SYS_NICE"
    )


def _has_capability(number: int) -> bool:
    for line in Path("/proc/thread-self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> number & 1)
    return False


def _memlock() -> str:
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return "infinite" if limit == resource.RLIM_INFINITY else f"{limit // 1024} KiB"


def _name(number: int) -> str:
    return errno.errorcode.get(number, str(number))
