# SPDX-License-Identifier: Apache-2.0
"""A daemon and its simulated drives, in one process each."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from dataclasses import dataclass
from pathlib import Path

from motord.api.page_file import own_page
from motord.client import Client, ClientError, MoveFailed, Refused
from motord.tools.simulator import start_simulator
from motord_hal.sim.control import SimControl

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "config/robots/demo.toml"
DEADLINE_S = 100.0
"""Only a hung program takes longer: a busy machine may need half a minute to start a program."""
PATIENT = (
    "safety.feedback_timeout_s=2.0",
    "safety.heartbeat_timeout_s=5.0",
    "safety.drive_watchdog_s=2.0",
    "safety.timeout_travel_max_m=1000.0",
)
"""Settings with which a delay by a busy machine is no fault: these tests do not check times."""
SLOW = (
    "joint.left.reply_timeout_s=0.2",
    "joint.right.reply_timeout_s=0.2",
    "loop.rate_hz=250",
)
"""Settings that slow the demonstration's robot: a faster loop takes a third of a CPU in each of the
tests that run side by side."""
UNHURRIED = (
    "input.socket.kind=socket", "input.socket.lease_s=1.0", "safety.command_timeout_s=1.0",
)  # fmt: skip
"""Settings with which a command that a busy machine delays is no fault."""
RETRIED = tuple(
    f"joint.{name}.{setting}"
    for name in ("left", "right")
    for setting in ("tries=10", "reply_timeout_s=0.2")
)
"""Settings with which a delayed reply is no fault, for two joints called left and right."""
SURE = (*UNHURRIED, *RETRIED)
POLL_S = 0.03
LATCHED_S = 15.0


HELD_TORQUE = (
    "safety.feedback.runaway_s=5",
    *(f"joint.{name}.velocity_max_rad_s=40" for name in ("left", "right")),
    *(f"joint.{name}.speed_loop.torque_max_n_m=1.5" for name in ("left", "right")),
)
"""Settings for two joints called left and right whose drives keep their torque while a busy machine
holds up the loop: with these settings it is no fault."""


def patient_on_can(folder, name, profile):
    """Return a copy of a robot file, which uses a copy of its drive profile. Both have time-outs
    that a simulator which a busy machine holds up does not reach."""
    drive = (ROOT / f"config/drives/{profile}.toml").read_text(encoding="utf-8")
    drive = re.sub(r"silence_s = .*", "silence_s = 5.0", drive)
    (folder / "patient.toml").write_text(
        drive.replace(f'name = "{profile}"', 'name = "patient"'), encoding="utf-8"
    )
    text = (ROOT / f"config/robots/{name}.toml").read_text(encoding="utf-8")
    text = re.sub(r"(\w+_timeout_s|drive_watchdog_s) = .*", r"\1 = 5.0", text)
    text = text.replace("[safety]", "[safety]\ntimeout_travel_max_m = 1000.0")
    file = folder / "cart.toml"
    file.write_text(text.replace(f'drive = "{profile}"', 'drive = "./patient.toml"'), "utf-8")
    return file


def wait_until(condition, what, deadline_s=DEADLINE_S):
    """Call `condition` until it is true, and return its value; fail with `what` at the deadline."""
    end_s = time.monotonic() + deadline_s
    while not (found := condition()):
        assert time.monotonic() < end_s, f"{what}: not within {deadline_s} s"
        time.sleep(POLL_S)
    return found


@dataclass
class Stage:
    daemon: subprocess.Popen
    sim: SimControl
    socket: Path
    log: Path
    robot: Client

    def state(self):
        return self.robot.status()["state"]

    def wait_for(self, *states):
        """Wait for one of these states. Fail when a fault stays latched for LATCHED_S instead."""
        latched_s = None

        def there():
            nonlocal latched_s
            now_s, state = time.monotonic(), self.state()
            latched_s = (latched_s or now_s) if state == "fault" else None
            held = latched_s is not None and now_s - latched_s > LATCHED_S
            assert state in states or not held, f"a fault, not {states}\n{self.logged()}"
            return state in states

        return wait_until(there, f"state {states}\n{self.logged()}")

    def logged(self):
        return self.log.read_text(encoding="utf-8")

    def client(self):
        return Client(self.socket, timeout_s=DEADLINE_S)

    def end(self, number=signal.SIGTERM):
        self.daemon.send_signal(number)
        return self.daemon.wait(DEADLINE_S)


def release_sources(stage):
    """Release the sources that an earlier test left held, as a person who arms an armed robot."""
    with contextlib.suppress(Refused):
        stage.robot.arm(release_held=True)


def set_off(stage, linear_m_s=0.4, fast_rad_s=3.0):
    """Arm and drive until the wheels are fast; reset a fault that a busy machine causes."""

    def turning():
        with contextlib.suppress(Refused):
            status = stage.robot.status()
            if status["state"] == "fault":
                stage.robot.reset()
            if not status["armed"]:
                stage.robot.arm()
                stage.robot.drive(0.0, 0.0)  # a command from before the fault holds the source
            stage.robot.drive(linear_m_s, 0.0)
        joints = stage.sim.truth().joints.values()
        return all(abs(joint.velocity_rad_s) > fast_rad_s for joint in joints)

    with contextlib.suppress(Refused):
        stage.robot.drive(0.0, 0.0)  # one from before a stop holds the source
    wait_until(turning, "the wheels turn")


def obeying(stage, command):
    """Arm, and wait until the robot moves. Call `command` repeatedly with whether motion may be
    commanded yet. Reset a fault that a busy machine latched meanwhile."""

    def attempt():
        state = stage.state()
        command(state in ("armed", "moving"))
        with contextlib.suppress(Refused):
            if state in ("fault", "estop"):
                stage.robot.reset()
            elif state == "idle":
                stage.robot.arm()
        return state == "moving"

    wait_until(attempt, f"moving\n{stage.logged()}")


def becomes_idle(stage):
    """Reset a latched fault, also one that a busy machine caused, and disarm."""

    def idle():
        with contextlib.suppress(ClientError):
            if stage.state() in ("fault", "estop"):
                stage.robot.reset()
            elif stage.state() != "idle":
                stage.robot.disarm()
        return stage.state() == "idle"

    wait_until(idle, "idle")


TRIES = 3


def was_held_up(error):
    """Return whether a busy machine ended a motion, because it held up the program or its feedback
    for half a second. An overshoot is not among these reasons: it is a failure."""
    return any(why in str(error) for why in ("stale", "was not read"))


def in_time(move):
    """Return the result of `move`; repeat it where it was held up, up to TRIES times."""
    for _ in range(TRIES - 1):
        try:
            return move()
        except MoveFailed as error:
            if not was_held_up(error):
                raise
    return move()


@contextlib.contextmanager
def armed(stage):
    """Arm the robot of `stage` from any state; at the end disarm it and wait until it rests."""

    def ready():
        with contextlib.suppress(ClientError):
            if stage.state() in ("fault", "estop"):
                stage.robot.reset()
            return stage.robot.arm() == "armed"
        return False

    wait_until(ready, "armed")
    release_sources(stage)
    yield stage
    with contextlib.suppress(ClientError):
        stage.robot.disarm()
    rests(stage)


def rests(stage):
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


def connected(daemon, socket, log):
    def attempt():
        assert daemon.poll() is None, log.read_text(encoding="utf-8")
        with contextlib.suppress(ClientError):
            return Client(socket, timeout_s=DEADLINE_S)
        return None

    return wait_until(attempt, "the socket")


def ended(daemon):
    """End the daemon by SIGTERM, at the deadline by SIGKILL."""
    daemon.send_signal(signal.SIGCONT)
    daemon.terminate()
    try:
        daemon.wait(DEADLINE_S)
    finally:
        daemon.kill()
        daemon.wait()


@contextlib.contextmanager
def running(
    folder,
    *settings,
    environ=None,
    robot=ROBOT,
    stdout=subprocess.DEVNULL,
    simulated=True,
    ports=None,
    motord=("-m", "motord"),
    stderr=None,
    options=(),
    sim_options=(),
    faults=(),
):
    """Run a daemon; yield its Stage. The robot's name is unique: each name has one state page.
    `ports`: settings of lines that are not `simulated` here."""
    with contextlib.ExitStack() as cleanup:
        nowhere = [f"line.rs485.port={json.dumps(str(folder / 'nothing'))}"]
        sim, places = None, nowhere if ports is None else ports
        if simulated:
            simulator = cleanup.enter_context(
                start_simulator(
                    robot,
                    link_dir=folder,
                    timeout_s=DEADLINE_S,
                    options=sim_options,
                    faults=faults,
                )
            )
            sim, places = simulator.control, simulator.settings
        name = f"t{uuid.uuid4().hex[:12]}"
        cleanup.callback(own_page(name).unlink, missing_ok=True)
        slow = SLOW if robot == ROBOT else ()
        overrides = [f"robot.name={name}", *PATIENT, *slow, *settings, *places]
        log, socket = folder / "daemon.log", folder / "daemon.sock"
        with log.open("wb") as sink:
            daemon = subprocess.Popen(
                [sys.executable, *motord, "run", str(robot), "--socket", str(socket), *options,
                 *(part for setting in overrides for part in ("--set", setting))],
                stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr or sink, cwd=ROOT,
                env={**os.environ, **(environ or {})},
            )  # fmt: skip
        cleanup.callback(ended, daemon)
        client = cleanup.enter_context(connected(daemon, socket, log))
        yield Stage(daemon, sim, socket, log, client)
