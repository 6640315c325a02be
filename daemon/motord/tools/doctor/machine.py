# SPDX-License-Identifier: Apache-2.0
"""Checks of the machine without its drives: kernel, processors, limits, memory, disk, clock, board.

Sources: sched(7), proc_sys_kernel(5), Documentation/admin-guide/pm/cpufreq.rst, pm_qos_interface,
Raspberry Pi firmware (get_throttled), drivers/hwmon/raspberrypi-hwmon.c, nvpmodel of Jetson Linux.
"""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Iterator
from pathlib import Path

from motord.tools.doctor.finding import Finding, Fix, Root, Verdict, Write
from motord.tools.latency.causes.machine import is_preempt_rt

_CAP_SYS_NICE, _CAP_IPC_LOCK = 23, 14
LIMITS = "/etc/security/limits.d/motord.conf"
PRIORITY = 80
"""The usual [loop] priority."""
DISK_FREE_MIN_BYTES = 200 * 1024 * 1024
_DISKS = ("/", "/run", "/dev/shm")  # noqa: S108  # the state page is there
_UNSYNCHRONISED = 5
"""Result TIME_ERROR of adjtimex(2): the clock is not synchronised."""
_THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
_NOW, _SINCE_START = 0xF, 0xF0000
"""Masks in get_throttled: bits 0 to 3 now, 16 to 19 since the start. The lowest bit of each is
under-voltage."""


def look(root: Root) -> Iterator[Finding]:
    """Run all checks; those of hardware that this machine does not have give no finding."""
    yield _kernel(root)
    yield from _governor(root)
    yield _isolated(root)
    yield _dma_latency(root)
    yield _priority(root)
    yield _throttling(root)
    yield _memory(root)
    yield from _disk(root)
    yield from _clock(root)
    yield from _raspberry(root)
    yield from _jetson(root)


def _machine(
    check: str, verdict: Verdict, text: str, mend: str = "", fixes: tuple[Fix, ...] = ()
) -> Finding:
    return Finding(
        group="machine", check=check, verdict=verdict, text=text,
        mend="" if verdict == "ok" else mend, fixes=() if verdict == "ok" else fixes,
    )  # fmt: skip


def _kernel(root: Root) -> Finding:
    version = root.text("/proc/sys/kernel/version")
    release = root.text("/proc/sys/kernel/osrelease")
    if is_preempt_rt(version, root.text("/sys/kernel/realtime")):
        return _machine("kernel", "ok", f"{release} with PREEMPT_RT")
    text = f"{release or 'unknown'} without PREEMPT_RT: single ticks may be milliseconds late"
    mend = "Debian: sudo apt install linux-image-rt-amd64 (arm64); motord latency measures the rest"
    return _machine("kernel", "warn", text, mend)


def _governor(root: Root) -> Iterator[Finding]:
    files = root.glob("/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    slow = [path for path in files if path.read_text(encoding="ascii").strip() != "performance"]
    if not files:
        yield _machine("governor", "ok", "the processors have no frequency scaling")
    elif not slow:
        yield _machine("governor", "ok", "performance on every processor")
    else:
        names = ", ".join(sorted({path.read_text(encoding="ascii").strip() for path in slow}))
        yield _machine(
            "governor", "warn",
            f"{names} on {len(slow)} of {len(files)} processors: they wake slowly",
            f"echo performance | sudo tee {root.root}sys/devices/system/cpu/cpu*/cpufreq/"
            "scaling_governor",
            tuple(Write(path=path, value="performance") for path in slow),
        )  # fmt: skip


def _isolated(root: Root) -> Finding:
    isolated = root.text("/sys/devices/system/cpu/isolated")
    if isolated:
        return _machine("isolated CPUs", "ok", f"CPU {isolated}: name them in [loop] cpu")
    return _machine("isolated CPUs", "ok", "none; isolcpus= in the kernel's command line is a step")


def _dma_latency(root: Root) -> Finding:
    device = root.path("/dev/cpu_dma_latency")
    if not device.exists():
        return _machine("cpu_dma_latency", "ok", "this kernel has no /dev/cpu_dma_latency")
    if permitted(root, device):
        return _machine("cpu_dma_latency", "ok", "the daemon can keep the processors awake")
    return _machine(
        "cpu_dma_latency", "warn",
        "/dev/cpu_dma_latency is not ours to write: deep sleep makes ticks some 100 us late",
        "echo 'KERNEL==\"cpu_dma_latency\", GROUP=\"dialout\", MODE=\"0660\"' | "
        "sudo tee /etc/udev/rules.d/99-motord.rules; sudo udevadm trigger",
    )  # fmt: skip


def _priority(root: Root) -> Finding:
    limit = root.limit("Max realtime priority")
    runtime_us = root.number("/proc/sys/kernel/sched_rt_runtime_us")
    if runtime_us == 0:
        return _machine(
            "real-time limits", "fail", "kernel.sched_rt_runtime_us is 0: no real-time threads",
            "sudo sysctl kernel.sched_rt_runtime_us=950000",
        )  # fmt: skip
    if root.capable(_CAP_SYS_NICE) or (limit.isdigit() and int(limit) >= PRIORITY):
        return _machine("real-time limits", "ok", f"SCHED_FIFO {PRIORITY} is permitted")
    return _machine(
        "real-time limits", "warn", f"rtprio is {limit or 'unknown'}: SCHED_OTHER, often late",
        f"echo '{user(root)} - rtprio {PRIORITY}' | sudo tee -a {LIMITS}, and log in again",
    )  # fmt: skip


def _throttling(root: Root) -> Finding:
    runtime_us = root.number("/proc/sys/kernel/sched_rt_runtime_us")
    period_us = root.number("/proc/sys/kernel/sched_rt_period_us") or 1_000_000
    if runtime_us is None or runtime_us < 0:
        return _machine("RT throttling", "ok", "off")
    part = runtime_us / period_us
    if part >= 0.5:
        return _machine("RT throttling", "ok", f"at {part:.0%}: motord needs a few per cent")
    return _machine(
        "RT throttling", "warn", f"real-time threads have {part:.0%} of a processor",
        "sudo sysctl kernel.sched_rt_runtime_us=950000",
    )  # fmt: skip


def _memory(root: Root) -> Finding:
    swaps = root.text("/proc/swaps").splitlines()[1:]
    limit = root.limit("Max locked memory")
    if root.capable(_CAP_IPC_LOCK) or limit == "unlimited":
        used = f"; swap on {len(swaps)} devices does not matter" if swaps else "; no swap"
        return _machine("swap", "ok", f"memory can be locked{used}")
    verdict: Verdict = "warn" if swaps else "ok"
    return _machine(
        "swap", verdict,
        f"memory cannot be locked (memlock {limit or 'unknown'})"
        + ("; a page that is swapped out stops the loop" if swaps else "; no swap"),
        f"echo '{user(root)} - memlock unlimited' | sudo tee -a {LIMITS}, and log in again",
    )  # fmt: skip


def _disk(root: Root) -> Iterator[Finding]:
    for path in _DISKS:
        try:
            found = os.statvfs(root.path(path))
        except OSError:
            continue
        free_bytes = found.f_bavail * found.f_frsize
        need_bytes = DISK_FREE_MIN_BYTES if path == "/" else 1 << 20
        if found.f_blocks and free_bytes < need_bytes:
            text = f"{path} has {free_bytes >> 20} MB left: recordings and the log may be lost"
            mend = "sudo journalctl --vacuum-size=100M; remove old recordings"
            yield _machine("disk", "fail" if path != "/" else "warn", text, mend)
            return
    yield _machine("disk", "ok", "room on /, /run and /dev/shm")


def _clock(root: Root) -> Iterator[Finding]:
    """Check the wall clock. It stamps messages for other machines; control uses CLOCK_MONOTONIC."""
    synchronised = root.path("/run/systemd/timesync/synchronized").exists()
    if synchronised or (root.real and _kernel_clock_is_set()):
        yield _machine("clock", "ok", "synchronised")
        return
    yield _machine(
        "clock", "warn", "the wall clock is not synchronised: stamps on buses may be wrong",
        "sudo timedatectl set-ntp true",
    )  # fmt: skip


def _kernel_clock_is_set() -> bool:
    """Whether the kernel's clock is synchronised, by adjtimex(2), which every time service uses."""
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):
        return False
    return 0 <= int(adjtimex(ctypes.create_string_buffer(512))) < _UNSYNCHRONISED


def _raspberry(root: Root) -> Iterator[Finding]:
    bits = root.text(_THROTTLED)
    alarms = [
        path.parent / "in0_lcrit_alarm"
        for path in root.glob("/sys/class/hwmon/hwmon*/name")
        if path.read_text(encoding="ascii", errors="replace").strip() == "rpi_volt"
    ]
    if not bits and not alarms:
        return
    word = int(bits, 16) if re.fullmatch(r"(0x)?[0-9a-fA-F]+", bits) else 0
    low = any(path.exists() and path.read_text().strip() == "1" for path in alarms)
    mend = "use a supply of 5.1 V that carries the current, short thick wires, a fan"
    if word & _NOW or low:
        what = "under-voltage" if word & 1 or low else "throttled by its temperature"
        yield _machine("supply", "fail", f"the board is slowed now: {what}", mend)
    elif word & _SINCE_START:
        what = "under-voltage" if word & 0x10000 else "throttling"
        yield _machine("supply", "warn", f"{what} since the start", mend)
    else:
        yield _machine("supply", "ok", "neither under-voltage nor throttling since the start")


def _jetson(root: Root) -> Iterator[Finding]:
    models: dict[int, str] = {
        int(number): name
        for number, name in re.findall(
            r"<\s*POWER_MODEL\s+ID=(\d+)\s+NAME=(\S+?)\s*>", root.text("/etc/nvpmodel.conf")
        )
    }
    mode = re.search(r"pmode:(\d+)", root.text("/var/lib/nvpmodel/status"))
    if not models or mode is None:
        return
    name: str = models.get(int(mode[1]), mode[1])
    full = [number for number, each in models.items() if each.startswith("MAXN")]
    if name.startswith("MAXN") or not full:
        yield _machine("power mode", "ok", name)
    else:
        text = f"{name}: lower clocks, and processors may be off"
        yield _machine("power mode", "warn", text, f"sudo nvpmodel -m {full[0]}")


# ---------------------------------------------------------------------------------------- this user
def user(root: Root) -> str:
    """Return this user's name, for commands; "$USER" if it is not in /etc/passwd."""
    number = root.status("Uid").split()[:1]
    rows = (row.split(":") for row in root.text("/etc/passwd").splitlines())
    found = [row[0] for row in rows if len(row) > 2 and [row[2]] == number]
    return found[0] if found else "$USER"


def permitted(root: Root, path: Path) -> bool:
    """Whether this user may read and write a device file, by its owner, group and mode."""
    try:
        info = path.stat()
    except OSError:
        return False
    uid = root.status("Uid").split()
    if not uid or uid[1] == "0":
        return True
    groups = {*root.status("Groups").split(), *root.status("Gid").split()}
    if str(info.st_uid) == uid[1]:
        return info.st_mode & 0o600 == 0o600
    if str(info.st_gid) in groups:
        return info.st_mode & 0o060 == 0o060
    return info.st_mode & 0o006 == 0o006
