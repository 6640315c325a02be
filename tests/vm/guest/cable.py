# SPDX-License-Identifier: Apache-2.0
"""A simulated drive at the other end of a real serial cable: UART and USB adapter of the guest are
connected to each other. And QEMU's monitor, to pull the adapter."""

import contextlib
import json
import os
import select
import threading
from pathlib import Path

from hardware import run_first
from shell import DEADLINE_S, wait_until

from motord_hal.serial.settings import set_raw
from motord_hal.serial.sysfs import usb_ports
from motord_hal.sim.control import SimControl

ROBOT = Path("/project/config/robots/demo.toml")
UART = "/dev/ttyS1"
ADAPTER_SERIAL = "A10K3XYZ"
SLOW_PROFILE = "./zlac8015d.toml"


def adapter():
    """The device file that the adapter has now; empty: it is not plugged in."""
    found = [port.device for port in usb_ports() if port.serial_number == ADAPTER_SERIAL]
    return found[0] if found and Path(found[0]).exists() else ""


def _monitor(command, **arguments):
    """Runs one command of QEMU's machine protocol (QMP); returns whether it succeeded."""
    with open("/dev/virtio-ports/monitor", "r+b", buffering=0) as port:
        reader = port
        for request in ({"execute": "qmp_capabilities"},
                        {"execute": command, "arguments": arguments}):  # fmt: skip
            port.write(json.dumps(request).encode() + b"\n")
            answer = {}
            while not answer.keys() & {"return", "error"}:
                answer = json.loads(reader.readline())
    return "error" not in answer


def pull():
    assert _monitor("device_del", id="adapter")
    wait_until(lambda: not adapter(), "the adapter is gone")


def plug():
    if adapter():
        return
    device = {"driver": "usb-serial", "id": "adapter", "chardev": "wire", "always-plugged": True}
    # QEMU frees the old adapter's end of the cable a little after the guest sees it leave
    wait_until(lambda: _monitor("device_add", serial=ADAPTER_SERIAL, **device), "it is plugged in")
    wait_until(adapter, "the adapter is back")


class Bridge:
    """Carries bytes between a simulator's pseudo-terminal and a real port."""

    def __init__(self, terminal, port, baudrate=115200):
        self._fds = [os.open(path, os.O_RDWR | os.O_NOCTTY) for path in (terminal, port)]
        for fd in self._fds:
            set_raw(fd, baudrate, "none", 1)
        self._end = os.eventfd(0)
        self._thread = threading.Thread(target=self._carry)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        os.eventfd_write(self._end, 1)
        self._thread.join()
        for fd in (*self._fds, self._end):
            os.close(fd)

    def _carry(self):
        run_first()
        one, other = self._fds
        while True:
            ready = select.select([one, other, self._end], [], [])[0]
            if self._end in ready:
                return
            for source, sink in ((one, other), (other, one)):
                if source in ready and (data := os.read(source, 256)):
                    os.write(sink, data)


def robot_file(folder, port, *, name="demo", **line):
    """The demo robot with time-outs longer than the delays of an emulated machine."""
    profile = ROBOT.parents[1] / "drives/zlac8015d.toml"
    text = profile.read_text(encoding="utf-8")
    slow = text.replace("turnaround_s = 0.005", "turnaround_s = 1.0")
    (folder / SLOW_PROFILE).write_text(slow, encoding="utf-8")
    text = ROBOT.read_text(encoding="utf-8")
    keys = "".join(f"{key} = {json.dumps(value)}\n" for key, value in line.items())
    for old, new in (
        ('name = "demo"', f'name = "{name}"'),
        ("rate_hz = 1000", "rate_hz = 50"),
        ('drive = "zlac8015d"', f'drive = "{SLOW_PROFILE}"'),
        ("command_timeout_s = 0.3", "command_timeout_s = 5.0"),
        ("feedback_timeout_s = 0.25", "feedback_timeout_s = 5.0"),
        ("heartbeat_timeout_s = 0.5", "heartbeat_timeout_s = 5.0\ntimeout_travel_max_m = 1000.0"),
        ("drive_watchdog_s = 0.5", "drive_watchdog_s = 8.0"),
        ('port = "/dev/ttyUSB0"', f"port = {json.dumps(str(port))}\n{keys}"),
        ("cycle_hz = 50", "cycle_hz = 5"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def behind(simulator, far_end):
    """The demo robot's drive at the far end of the cable; yields the simulator's control."""
    control = SimControl(simulator.control_path, timeout_s=DEADLINE_S)
    with Bridge(simulator.ports["rs485"], far_end), contextlib.closing(control):
        yield control
