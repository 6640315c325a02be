# SPDX-License-Identifier: Apache-2.0
"""Records docs/first-drive.md: a robot from new parts to a calibrated base, on simulated drives
whose wheels and track differ from the robot file. Run: make walk."""

import contextlib
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.sim.daemon_stage import (
    DEADLINE_S,
    PATIENT,
    ROBOT,
    ROOT,
    SLOW,
    SURE,
    UNHURRIED,
    connected,
    ended,
)
from tests.sim.person_stage import at_terminal
from tests.sim.pseudo_terminal import at_terminal as keyboard

from motord.client import Client, ClientError
from motord.tools.simulator import start_simulator

PAGE = ROOT / "docs/first-drive.md"
RADIUS_M, TRACK_M = 0.0825, 0.45
TRUTH = {
    "joint.left.wheel_radius_m": 1.03 * RADIUS_M,
    "joint.right.wheel_radius_m": 1.02 * RADIUS_M,
    "base.track_m": 0.96 * TRACK_M,
}
TRIES = 4
"""Tries of a step: a busy machine may hold up the simulated robot for too long."""
HEAD = """\
# From new parts to a calibrated base

A recorded walk: `make walk` made this page, on simulated drives that speak their real protocols.
The first robot has a ZLAC8015D on a serial port (Modbus). Its left wheel is truly 3 % larger than
the person believes, its right wheel 2 %, and its track is 4 % narrower. The person reads a tape to
the millimetre. The second robot has a pair of ODrives on a CAN bus, which a socket stands for: on a
robot its name is `can0`. What the person types follows each question.

"""
CLONE_WITHIN_S = 1800.0


class Walk:
    """The steps, their output and their duration."""

    def __init__(self):
        self.parts, self.times = [HEAD], []

    def step(self, title, words, replies, socket=None):
        """Run a command with these replies, up to TRIES times; add it and return its exit status.
        `socket`: the daemon whose fault is reset before the next try, or None."""
        for _ in range(TRIES):
            began_s = time.monotonic()
            with at_terminal(*words) as screen:
                status = screen.answers(replies)
            took_s = time.monotonic() - began_s
            if not status:
                break
            print(f"{title}: again\n{screen.text}", file=sys.stderr)
            if socket is not None:
                rested(socket)
        return self.add(title, " ".join(["motord", *map(str, words)]), screen.text, took_s, status)

    def add(self, title, command, text, took_s, status):
        """Add a completed step; return its exit status."""
        self.times.append((title, took_s))
        kept = re.sub(r"[ \t]+\n", "\n", shown(text)).strip()
        session = f"$ {shown(command)}\n{kept}"
        self.parts.append(f"## {title}\n\n{took_s:.0f} s\n\n```\n{session}\n```\n\n")
        print(f"{title}: {took_s:.0f} s, exit status {status}", file=sys.stderr)
        if status:
            print(text, file=sys.stderr)
        return status

    def page(self):
        rows = [f"| {title} | {took_s:.0f} s |" for title, took_s in self.times]
        total_s = sum(took_s for _, took_s in self.times)
        table = "\n".join(["| step | time |", "|---|---|", *rows, f"| all | {total_s:.0f} s |"])
        return "".join([self.parts[0], table, "\n\n", *self.parts[1:]]).rstrip() + "\n"


def rested(socket):
    """Wait until the daemon is idle; reset a fault that a busy machine has caused."""
    end_s = time.monotonic() + DEADLINE_S
    with Client(socket) as robot:
        while (status := robot.status()).state != "idle":
            assert time.monotonic() < end_s, status.why
            with contextlib.suppress(ClientError):
                robot.reset()
            time.sleep(0.1)


PLACES = {}


def shown(text):
    """Return the text without the folder names of this recording."""
    text = str(text)
    for path in sorted(PLACES, key=len, reverse=True):
        text = text.replace(path, PLACES[path])
    return text


@contextlib.contextmanager
def running(file, folder, name, *settings):
    log = folder / "daemon.log"
    patience = [part for one in (*PATIENT, *settings) for part in ("--set", one)]
    with log.open("wb") as sink:
        daemon = subprocess.Popen(
            [sys.executable, "-m", "motord", "run", str(file), *patience], cwd=ROOT, stderr=sink,
            env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
        )  # fmt: skip
    try:
        socket = next(
            place
            for place in (Path("/run/motord"), folder / "motord")
            if place.parent.exists() and (place == folder / "motord" or os.access("/run", os.W_OK))
        )
        with connected(daemon, socket / f"{name}.sock", log):
            rested(socket / f"{name}.sock")
        PLACES[f" --socket {socket / name}.sock"] = ""
        yield socket / f"{name}.sock"
    finally:
        ended(daemon)


def cloned(walk, folder):
    """Build a clone and drive a simulated robot with it."""
    began_s = time.monotonic()
    place = folder / "motord"
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(place)], check=True, timeout=120)
    done = subprocess.run(
        ["make", "--silent", "demo", "ARGS=--seconds 10"], cwd=place, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=CLONE_WITHIN_S,
        env={key: value for key, value in os.environ.items() if not key.startswith("MAKE")},
    )  # fmt: skip
    command = 'git clone URL motord && cd motord && make demo ARGS="--seconds 10"'
    took_s = time.monotonic() - began_s
    return walk.add("Fresh clone", command, done.stdout, took_s, done.returncode)


ANSWERS = {
    r"Which drive profile\? \[.*?\] ": "", r"robot's name\? \[.*?\] ": "",
    r"\[differential/.*?\] ": "differential",
    r"Radius of a loaded wheel.*?\[m\] ": f"{RADIUS_M}",
    r"Distance from the middle.*?\[m\] ": f"{TRACK_M}",
    r"Top speed.*?\[m/s\] ": "0.5", r"Fastest turn.*?\[rad/s\] ": "1",
    r"Motor turns.*?\[1\] ": "1", r"Unit and channel.*?\[\d\.\d\] ": "",
}  # fmt: skip


def main():
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that `finally` ends the daemon
    walk, status = Walk(), 0
    PLACES[str(ROOT)] = "/opt/motord"
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        PLACES[f"{folder}/"] = ""
        status += cloned(walk, folder)
        status += on_a_serial_port(walk, folder)
        status += on_a_can_bus(walk, folder)
    if not status:
        PAGE.write_text(walk.page(), encoding="utf-8")
    return status


def on_a_serial_port(walk, folder):
    options = [part for key, value in TRUTH.items() for part in ("--set", f"{key}={value}")]
    with start_simulator(ROBOT, link_dir=folder, options=options, timeout_s=DEADLINE_S) as sim:
        port, file = folder / "rs485", folder / "cart.toml"
        title = "ZLAC8015D: find the drive, write the file"
        PLACES[str(port)] = "/dev/ttyUSB0"
        status = walk.step(title, ["init", file, "--at", port], ANSWERS)
        with running(file, folder, "cart", *SLOW, *SURE) as socket:
            status += spun(walk, "ZLAC8015D", socket)
            status += calibrated(walk, sim.control, socket)
        with running(file, folder, "cart", *SLOW, *SURE) as socket:  # uses the calibrated values
            return status + driven(walk, "ZLAC8015D", sim.control, socket)


def on_a_can_bus(walk, folder):
    pair, address = ROBOT.parent / "odrive-two.toml", f"unix:{folder}/bus"
    options = ("--can", address)
    with start_simulator(
        pair, link_dir=folder / "pair", options=options, timeout_s=DEADLINE_S
    ) as sim:
        file = folder / "duo.toml"
        title = "ODrives: find the drives, write the file"
        status = walk.step(title, ["init", file, "--at", address], ANSWERS)
        with running(file, folder, "duo", *UNHURRIED, "loop.rate_hz=250") as socket:
            status += spun(walk, "ODrives", socket)
            return status + driven(walk, "ODrives", sim.control, socket)


def spun(walk, drives, socket):
    return walk.step(f"{drives}: first turn of each wheel", ["spin", "--all", "--socket", socket], {
        r"in their reach\? \[y/n\] ": "y", r"turn forward\? \[.*?\] ": "forward",
    }, socket)  # fmt: skip


def powered(terminal, socket):
    """Return whether the robot is armed; press the key to arm if idle, to reset if in fault."""
    with Client(socket) as robot:
        state = robot.status().state
    if state in ("idle", "fault"):
        terminal.type("m" if state == "idle" else "r")
        end_s = time.monotonic() + 1.0
        terminal.wait_until(lambda: time.monotonic() > end_s, "the answer")
    return state == "armed"


def driven(walk, drives, sim, socket):
    """Hold a key until the robot has driven half a metre, and another until it has turned."""
    began_s = time.monotonic()
    sim.reset_truth()
    with keyboard("teleop", "--socket", str(socket), "--first-s", "1.0") as terminal:
        terminal.wait_for("m/s")
        terminal.wait_until(lambda: powered(terminal, socket), "armed")
        for key, far in (
            ("w", lambda: sim.truth().distance_m > 0.5),
            ("a", lambda: abs(sim.truth().turned_rad) > 1.0),
        ):
            terminal.wait_until(far, f"{key} is held", keys=key)
            terminal.wait_until(lambda: sim.truth().at_rest, "at rest after the key's release")
            state = terminal.text
        terminal.type("x")
        status = terminal.exit_status()
    rows = [row for row in re.split(r"[\r\n]+", state) if row.strip()]
    text = "\n".join([*rows[:3], "(m: armed; w held for 0.5 m; a held for 1 rad)", rows[-1]])
    command, took_s = f"motord teleop --socket {socket} --first-s 1.0", time.monotonic() - began_s
    return walk.add(f"{drives}: drive by keyboard", command, text, took_s, status)


def calibrated(walk, sim, socket):
    def on_mark():
        sim.reset_truth()
        return "y"

    truth = sim.truth
    return walk.step("ZLAC8015D: calibrate", ["calibrate", "all", "--socket", socket], {
        r"stand on its mark\? \[y/n\] ": on_mark,
        r"Is there room all around it\? \[y/n\] ": on_mark,
        r"in front of the mark .*?\[m\] ": lambda: f"{truth().x_m:.3f}",
        r"to the left of the line .*?\[m\] ": lambda: f"{truth().y_m:.3f}",
        r"By how many degrees .*?\[°\] ": lambda: f"{math.degrees(truth().heading_rad):.1f}",
        r"Write \S+ ?\[y/n\] ": "y", r"Write .*?\? \[y/n\] ": "y",
    }, socket)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
