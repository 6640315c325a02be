# SPDX-License-Identifier: Apache-2.0
"""Facts about the machine of a measurement that can make its numbers differ from those of another
machine. They do not identify the machine or its owner."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any


def machine_facts() -> dict[str, Any]:
    """Return facts about kernel and processor, and whether a hypervisor is below; no host name."""
    cpuinfo = _text("/proc/cpuinfo")
    return {
        "kernel": platform.release(),
        "kernel_version": platform.version(),
        "preempt_rt": is_preempt_rt(platform.version(), _text("/sys/kernel/realtime")),
        "architecture": platform.machine(),
        "cpu_model": cpu_model(cpuinfo, _text("/proc/device-tree/model")),
        "cpu_count": os.cpu_count() or 1,
        "cpus_allowed": len(os.sched_getaffinity(0)),
        "virtual": is_virtual(cpuinfo),
        "clocksource": _text(
            "/sys/devices/system/clocksource/clocksource0/current_clocksource"
        ).strip(),
    }


def is_preempt_rt(version: str, sys_kernel_realtime: str) -> bool:
    """Whether the kernel is PREEMPT_RT. Newer kernels show it in `uname -v`, older ones in
    /sys/kernel/realtime, some in both."""
    return "PREEMPT_RT" in version.replace(" ", "_") or sys_kernel_realtime.strip() == "1"


def cpu_model(cpuinfo: str, device_tree_model: str) -> str:
    """Return the model of the processor or board: boards have it in the device tree, PCs in
    /proc/cpuinfo."""
    named = [line for line in cpuinfo.splitlines() if line.startswith("model name")]
    return device_tree_model.strip("\0\n ") or (named[0].split(":", 1)[1].strip() if named else "")


def is_virtual(cpuinfo: str) -> bool:
    """Whether there is a hypervisor, by a processor flag of x86; False on other processors."""
    flags = [line for line in cpuinfo.splitlines() if line.startswith("flags")]
    return bool(flags) and "hypervisor" in flags[0].split()


@dataclass(frozen=True, slots=True)
class CpuTimes:
    """Times of all processors together since boot, in clock ticks."""

    total: int
    steal: int

    @classmethod
    def now(cls) -> CpuTimes:
        return cls.parse(_text("/proc/stat"))

    @classmethod
    def parse(cls, proc_stat: str) -> CpuTimes:
        """Parse the first line of /proc/stat (proc(5)): cpu user nice system idle iowait irq
        softirq steal. The guest time that follows is already contained in user."""
        fields = [int(word) for word in proc_stat.split("\n", 1)[0].split()[1:9]]
        return cls(sum(fields), fields[7] if len(fields) > 7 else 0)

    def steal_percent_since(self, before: CpuTimes) -> float:
        return 100.0 * (self.steal - before.steal) / max(self.total - before.total, 1)


def _text(path: str) -> str:
    """Return a file's text; empty if this kernel has no such file."""
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
