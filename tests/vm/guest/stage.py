# SPDX-License-Identifier: Apache-2.0
"""A running daemon for a test: its own reports, and what the wheels really do."""

import contextlib
import subprocess
from dataclasses import dataclass
from pathlib import Path

from shell import DEADLINE_S, wait_until

from motord.client import Client, ClientError, Refused
from motord_hal.sim.control import SimControl


@dataclass
class Stage:
    sim: SimControl
    robot: Client
    log: Path | None = None
    process: subprocess.Popen | None = None

    def state(self):
        return self.robot.status()["state"]

    def wait_for(self, *states):
        wait_until(lambda: self.state() in states, f"state {states}", self.logged)

    def logged(self):
        return self.log.read_text(encoding="utf-8")

    def armed(self):
        """Arms, after a fault too: a machine that stood still for seconds may have latched one."""
        status = self.robot.status()
        if status["state"] == "fault":
            print("a fault:", status["why"])
            self.robot.reset()
        if not status["armed"]:
            self.robot.arm()
        return True

    def drive_on(self, speed_m_s=0.5):
        """Armed, and the simulated wheels turn."""
        self.wait_for("idle", "armed", "fault")

        def turning():
            self.armed()
            self.robot.drive(speed_m_s, 0.0)
            joints = self.sim.truth().joints.values()
            return all(abs(joint.velocity_rad_s) > 2.0 for joint in joints)

        granted(turning, "the wheels turn", self.logged)

    def rests_without_power(self):
        truth = self.sim.truth()
        return truth.at_rest and not any(joint.enabled for joint in truth.joints.values())


def granted(ask, what="it is granted", shown=str):
    """Calls `ask` until it is neither refused nor answered with False."""

    refusals = [""]

    def attempt():
        try:
            return ask() is not False
        except Refused as refusal:
            refusals.append(str(refusal))
            return False

    wait_until(attempt, what, lambda: f"{refusals[-1]}\n{shown()}")


@contextlib.contextmanager
def daemon(folder, robot, sim):
    """motord run on a robot file, in the foreground."""
    log, socket = folder / "daemon.log", folder / "daemon.sock"
    with log.open("wb") as sink:
        process = subprocess.Popen(
            ["motord", "run", str(robot), "--socket", str(socket)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=sink,
        )  # fmt: skip

    def connected():
        assert process.poll() is None, log.read_text(encoding="utf-8")
        with contextlib.suppress(ClientError):
            return Client(socket, timeout_s=DEADLINE_S)
        return None

    try:
        with wait_until(connected, "its socket") as client:
            yield Stage(sim, client, log, process)
    finally:
        process.terminate()
        try:
            process.wait(DEADLINE_S)
        finally:
            process.kill()
            process.wait()
