# SPDX-License-Identifier: Apache-2.0
"""make vm: builds the guest and the package, boots once, runs tests/vm/guest there, prints their
output; then tests/vm/pi on an emulated Raspberry Pi 3. With --smoke only the guest's tests marked
smoke run; with --build nothing is booted. Other arguments go to the guest's pytest, and the Pi is
left out. Without root, Debian 12 on amd64 or QEMU's packages: the reason in one line, and status 0.

Emulated, not virtualised: time in the guest means nothing, what the kernel does is real. How long
the tests may take follows from how long the guest takes to boot and to install the package, which
is the same work each time: a slower machine gets more time.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
BUILD = ROOT / "build" / "vm"
BUILD_PI = ROOT / "build" / "pi"
SET_UP_WITHIN_S = 900.0
TESTS_WITHIN_S = 2400.0
"""A lower bound; an idle machine of two cores needs less."""
TESTS_PER_SET_UP = 40.0
"""How many times as long as its set-up a guest's tests may take."""
ADAPTER_SERIAL = "A10K3XYZ"
SMOKE, BUILD_ONLY = "--smoke", "--build"
SET_UP = "guest: set up"
STATUS = "guest: status "
DISK_MB = 120
SHARED = (
    "loop_side.py", "scripted_odrive.py", "scripted_moteus.py", "shared_bus.py", "cia402_node.py",
    "can_rig.py",
    "test_can_line.py", "test_can_bus.py", "test_can_halt.py", "test_cia402.py", "test_moteus.py",
)  # fmt: skip
"""Files of the contract suite, run on real buses here."""


def why_not() -> str:
    """Why the guest cannot be made here; empty if it can."""
    if os.geteuid() != 0:
        return "needs root, to make a file system of Debian packages"
    release = Path("/etc/os-release")
    if not release.exists() or "VERSION_CODENAME=bookworm" not in release.read_text("utf-8"):
        return "needs Debian 12, whose packages the guest is made of"
    if os.uname().machine != "x86_64":
        return "needs an x86-64 machine"
    wanted = ("qemu-system-x86_64", "qemu-system-aarch64", "aarch64-linux-gnu-gcc", "mmdebstrap")
    if not all(map(shutil.which, wanted)) and os.environ.get("MOTORD_VM_INSTALL") != "1":
        packages = "qemu-system-x86 qemu-system-arm gcc-aarch64-linux-gnu mmdebstrap"
        return f"needs {', '.join(wanted)} (apt install {packages})"
    return ""


def make_disk(package: Path, arguments: list[str], folder: Path) -> Path:
    """The files that the guest tests, as a disk."""
    content, disk = folder / "content", folder / "project.ext4"
    shutil.copytree(HERE / "guest", content / "tests/vm/guest",
                    ignore=shutil.ignore_patterns("__pycache__"))  # fmt: skip
    for name in SHARED:
        (path,) = (ROOT / "tests/contract").rglob(name)
        shutil.copy(path, content / "tests/vm/guest")
    shutil.copytree(ROOT / "config", content / "config")
    shutil.copy(package, content / "motord.deb")
    (content / "arguments").write_text("".join(f"{each}\n" for each in arguments), "utf-8")
    subprocess.run(
        ["mke2fs", "-q", "-F", "-t", "ext4", "-d", content, disk, f"{DISK_MB}M"],
        check=True, timeout=60,
    )  # fmt: skip
    return disk


def free_ports() -> tuple[int, int]:
    """Of UDP, on this machine."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for end in (one, other):
            end.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


def cable_end(name: str, port: int, far_port: int) -> str:
    """Datagrams: like a cable they lose what is not read. A stream would get full, and then QEMU
    waits while it holds the lock that its reader needs."""
    return f"udp,id={name},host=127.0.0.1,port={far_port},localaddr=127.0.0.1,localport={port}"


def qemu(disk: Path, folder: Path) -> list[str]:
    """The machine: a UART (ttyS1) cabled to a USB adapter, two CAN controllers on one bus, and the
    monitor as a port in the guest, so that a test can pull the adapter by itself."""
    monitor = folder / "monitor"
    one, other = free_ports()
    append = "console=ttyS0 quiet loglevel=4 audit=0 mitigations=off"
    return [
        "qemu-system-x86_64", "-accel", "tcg,thread=multi",
        "-cpu", "max", "-smp", "2", "-m", "1024", "-nodefaults", "-display", "none", "-no-reboot",
        "-kernel", str(BUILD / "vmlinuz"), "-initrd", str(BUILD / "initrd.gz"),
        "-append", append,
        "-drive", f"file={BUILD / 'root.ext4'},if=virtio,format=raw,snapshot=on,cache=unsafe",
        "-drive", f"file={disk},if=virtio,format=raw,readonly=on",
        "-chardev", f"file,id=console,path={BUILD / 'console.log'}", "-serial", "chardev:console",
        "-chardev", cable_end("wire", one, other),
        "-chardev", cable_end("uart", other, one), "-serial", "chardev:uart",
        "-device", "qemu-xhci", "-device",
        f"usb-serial,id=adapter,chardev=wire,always-plugged=on,serial={ADAPTER_SERIAL}",
        "-chardev", f"socket,id=qmp,path={monitor},server=on,wait=off",
        "-mon", "chardev=qmp,mode=control",
        "-chardev", f"socket,id=monitor,path={monitor},reconnect=1",
        "-device", "virtio-serial-pci", "-device", "virtserialport,chardev=monitor,name=monitor",
        "-chardev", "file,id=out,path=/dev/stdout",
        "-device", "virtserialport,chardev=out,name=out",
        "-object", "can-bus,id=can",
        "-device", "kvaser_pci,canbus=can", "-device", "kvaser_pci,canbus=can",
    ]  # fmt: skip


def raspberry_pi() -> list[str]:
    """One QEMU thread: with one for each CPU, those not started yet spin."""
    append = "console=ttyS1 quiet loglevel=1 rdinit=/init panic=-1"
    return [
        "qemu-system-aarch64", "-M", "raspi3b", "-accel", "tcg,thread=single",
        "-nodefaults", "-display", "none", "-no-reboot",
        "-kernel", str(BUILD_PI / "vmlinuz"), "-dtb", str(BUILD_PI / "pi.dtb"),
        "-initrd", str(BUILD_PI / "initrd.gz"), "-append", append,
        "-serial", "null", "-chardev", "stdio,id=out,signal=off", "-serial", "chardev:out",
    ]  # fmt: skip


class Limit:
    """Ends a machine after its time."""

    def __init__(self, machine: subprocess.Popen[bytes]) -> None:
        self._machine = machine
        self._began_s = time.monotonic()
        self._allow(SET_UP_WITHIN_S)

    def _allow(self, seconds: float) -> None:
        self._timer = threading.Timer(seconds, self._machine.kill)
        self._timer.daemon = True
        self._timer.start()

    def set_up(self) -> str:
        """Sets the limit by the time that the set-up took."""
        self._timer.cancel()
        took_s = time.monotonic() - self._began_s
        within_s = max(TESTS_WITHIN_S, TESTS_PER_SET_UP * took_s)
        self._allow(within_s)
        return f"{SET_UP} in {took_s:.0f} s: its tests may take {within_s:.0f} s"

    def end(self) -> None:
        self._timer.cancel()


def boot(command: list[str], say: Callable[[str], None], *, ends_itself: bool) -> int:
    """The status that the guest reported; 1 where it reported none."""
    status = None
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as machine:
        assert machine.stdout is not None
        limit = Limit(machine)
        for raw in machine.stdout:
            line = raw.decode(errors="replace").rstrip("\r\n")
            if line == SET_UP:
                say(limit.set_up())
            elif line.startswith(STATUS):
                status = int(line.removeprefix(STATUS))
                if not ends_itself:
                    machine.terminate()
            else:
                say(line)
        machine.wait()
        limit.end()
    if status is None or (ends_itself and machine.returncode != 0):
        print(f"make vm: the guest did not end by itself: {BUILD / 'console.log'}", file=sys.stderr)
        return 1
    return status


def build_pi() -> None:
    subprocess.run([HERE / "pi" / "image.sh", BUILD_PI, ROOT], check=True, timeout=600)


def on_the_pi(shown: list[str]) -> int:
    """Runs its tests beside the other guest, which uses one CPU; keeps their output for later."""
    build_pi()
    return boot(raspberry_pi(), shown.append, ends_itself=False)


def on_the_guest(package: Path, arguments: list[str]) -> int:
    with tempfile.TemporaryDirectory(prefix="motord-vm-") as folder:
        disk = make_disk(package, arguments, Path(folder))
        return boot(qemu(disk, Path(folder)), partial(print, flush=True), ends_itself=True)


def main(arguments: list[str]) -> int:
    reason = why_not()
    if reason:
        print(f"make vm: skipped: {reason}", file=sys.stderr)
        return 0
    begin_s = time.monotonic()
    subprocess.run([HERE / "image.sh", BUILD], check=True, timeout=600)
    made = subprocess.run([ROOT / "systemd" / "deb.sh", ROOT / "build" / "deb"],
                          check=True, timeout=300, stdout=subprocess.PIPE, text=True)  # fmt: skip
    package = Path(made.stdout.strip())
    if arguments == [BUILD_ONLY]:
        build_pi()
        return 0
    if arguments not in ([], [SMOKE]):
        return on_the_guest(package, arguments)
    shown: list[str] = []
    with ThreadPoolExecutor(1) as pool:
        pi = pool.submit(on_the_pi, shown)
        status = on_the_guest(package, arguments)
    print("\nRaspberry Pi 3:", *shown, sep="\n")
    took_s = time.monotonic() - begin_s
    print(f"make vm: guest {status}, Raspberry Pi {pi.result()} (0: passed), {took_s:.0f} s")
    return status or pi.result()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
