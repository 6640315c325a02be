# SPDX-License-Identifier: Apache-2.0
"""motord@ROBOT.service with time-outs for an emulated machine, and queries of its state."""

import contextlib
import socket
import struct
from pathlib import Path

from shell import DEADLINE_S, journal, output, properties, wait_until
from stage import Stage

from motord.client import Client, ClientError

ETC = Path("/etc/motord")
PATIENT = "[Service]\nWatchdogSec=30\nTimeoutStartSec=90\nTimeoutStopSec=60\n"


class Unit(Stage):
    """The daemon as systemd runs it."""

    def __init__(self, name, sim, robot):
        super().__init__(sim, robot)
        self.name = name
        self.unit = f"motord@{name}.service"

    def logged(self):
        return "\n".join(entry["MESSAGE"] for entry in journal(self.unit))

    def main_pid(self):
        return int(properties(self.unit, "MainPID")["MainPID"])

    def is_idle(self):
        """Whether it is idle; resets or disarms it if not."""
        state = self.state()
        if state == "fault":
            self.robot.reset()
        elif state != "idle":
            self.robot.disarm()
        return state == "idle"

    def again(self, old_pid):
        """Waits for the next process of the unit, and connects to it."""
        self.robot.close()
        self.robot = wait_until(
            lambda: connected(self.name, old_pid), "it is started again", self.logged
        )
        return self


def connected(name, old_pid=0):
    """A client; None while only the old process listens: SO_PEERCRED, cheaper than systemd."""
    path = Path(f"/run/motord/{name}.sock")
    with contextlib.suppress(ClientError, OSError), socket.socket(socket.AF_UNIX) as probe:
        probe.connect(str(path))
        found = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        if struct.unpack("3i", found)[0] != old_pid:
            return Client(path, timeout_s=DEADLINE_S)
    return None


@contextlib.contextmanager
def prepared(name, more=""):
    """Sets its longer time-outs; afterwards the unit is stopped and they are removed."""
    unit = f"motord@{name}.service"
    drop_in = Path(f"/run/systemd/system/{unit}.d/patient.conf")
    drop_in.parent.mkdir(parents=True, exist_ok=True)
    drop_in.write_text(PATIENT + more)
    output("systemctl", "daemon-reload")
    try:
        yield
    finally:
        output("systemctl", "stop", unit)
        drop_in.unlink()
        drop_in.parent.rmdir()
        output("systemctl", "daemon-reload")


@contextlib.contextmanager
def reached(name, sim):
    """The running unit, started if needed, and left running."""
    output("systemctl", "start", f"motord@{name}.service")
    with wait_until(lambda: connected(name), "it listens") as client:
        running = Unit(name, sim, client)
        running.wait_for("idle", "fault", "armed", "moving")
        yield running
        running.robot.close()


@contextlib.contextmanager
def started(name, sim):
    """The running unit, idle or with a fault; stopped afterwards."""
    try:
        with reached(name, sim) as running:
            yield running
    finally:
        output("systemctl", "stop", f"motord@{name}.service")
