# SPDX-License-Identifier: Apache-2.0
"""Records docs/first-drive.md: a new robot from its box to a calibrated base, on simulated drives
whose wheels and track differ from what the person believes. Run: make walk."""

import contextlib
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.sim.daemon_stage import DEADLINE_S, PATIENT, ROBOT, ROOT, SLOW, connected, ended
from tests.sim.person_stage import at_terminal

from motord.tools.simulator import start_simulator

PAGE = ROOT / "docs/first-drive.md"
RADIUS_M, TRACK_M = 0.0825, 0.45
TRUTH = {
    "joint.left.wheel_radius_m": 1.03 * RADIUS_M,
    "joint.right.wheel_radius_m": 1.02 * RADIUS_M,
    "base.track_m": 0.96 * TRACK_M,
}
TRIES = 4
"""A busy machine may hold up the simulated robot for too long."""
HEAD = """\
# From the box to a calibrated base

A recorded walk: `make walk` made this page. The drive is a simulated ZLAC8015D that speaks real
Modbus on a serial port. Its left wheel is truly 3 % larger than the person believes, its right
wheel 2 %, and its track is 4 % narrower. The person reads a tape to the millimetre. What the person
types follows each question.

In a fresh clone, `make demo` builds motord once. On a robot, leave out the simulated drive.

"""


class Walk:
    """The steps, what they printed, and how long they took."""

    def __init__(self):
        self.parts, self.times = [HEAD], []

    def step(self, title, words, replies):
        for _ in range(TRIES):
            began_s = time.monotonic()
            with at_terminal(*words) as screen:
                status = screen.answers(replies)
            took_s = time.monotonic() - began_s
            if not status:
                break
            print(f"{title}: again\n{screen.text}", file=sys.stderr)
        self.times.append((title, took_s))
        command = shown(" ".join(["motord", *map(str, words)]))
        text = re.sub(r"[ \t]+\n", "\n", shown(screen.text)).strip()
        self.parts.append(f"## {title}\n\n{took_s:.0f} s\n\n```\n$ {command}\n{text}\n```\n\n")
        print(f"{title}: {took_s:.0f} s, exit status {status}", file=sys.stderr)
        if status:
            print(screen.text, file=sys.stderr)
        return status

    def page(self):
        rows = [f"| {title} | {took_s:.0f} s |" for title, took_s in self.times]
        total_s = sum(took_s for _, took_s in self.times)
        table = "\n".join(["| step | time |", "|---|---|", *rows, f"| all | {total_s:.0f} s |"])
        return "".join([self.parts[0], table, "\n\n", *self.parts[1:]]).rstrip() + "\n"


PLACES = {}


def shown(text):
    """Without the names of folders that only this recording has."""
    text = str(text)
    for path, name in PLACES.items():
        text = text.replace(path, name)
    return text


@contextlib.contextmanager
def running(file, folder, name):
    log = folder / "daemon.log"
    patience = [part for setting in (*PATIENT, *SLOW) for part in ("--set", setting)]
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
        with connected(daemon, socket / f"{name}.sock", log) as robot:
            while robot.status().state != "idle":
                time.sleep(0.05)
        yield socket / f"{name}.sock"
    finally:
        ended(daemon)


def main():
    walk = Walk()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        options = [part for key, value in TRUTH.items() for part in ("--set", f"{key}={value}")]
        with start_simulator(ROBOT, link_dir=folder, options=options, timeout_s=DEADLINE_S) as sim:
            port, file = folder / "rs485", folder / "cart.toml"
            PLACES.update({str(port): "/dev/ttyUSB0", f"{folder}/": "", str(ROOT): "/opt/motord"})
            status = walk.step("Find the drive, write the file", ["init", file, "--at", port], {
                r"Which drive profile\? \[.*?\] ": "", r"robot's name\? \[.*?\] ": "",
                r"\[differential/skid\] ": "d", r"Radius of a loaded wheel.*?\[m\] ": f"{RADIUS_M}",
                r"Distance from the middle.*?\[m\] ": f"{TRACK_M}",
                r"Top speed.*?\[m/s\] ": "0.5", r"Fastest turn.*?\[rad/s\] ": "1",
                r"Motor turns.*?\[1\] ": "1", r"Unit and channel.*?\[\d\.\d\] ": "",
            })  # fmt: skip
            with running(file, folder, "cart") as socket:
                PLACES[f" --socket {socket}"] = ""
                status += spin_and_calibrate(walk, sim.control, socket)
    if not status:
        PAGE.write_text(walk.page(), encoding="utf-8")
    return status


def spin_and_calibrate(walk, sim, socket):
    def on_mark():
        sim.reset_truth()
        return "y"

    truth = sim.truth
    status = walk.step("First turn of each wheel", ["spin", "--all", "--socket", socket], {
        r"in their reach\? \[y/n\] ": "y", r"turn forward\? \[.*?\] ": "forward",
    })  # fmt: skip
    return status + walk.step("Calibrate", ["calibrate", "all", "--socket", socket], {
        r"stand on its mark\? \[y/n\] ": on_mark,
        r"Is there room all around it\? \[y/n\] ": on_mark,
        r"in front of the mark .*?\[m\] ": lambda: f"{truth().x_m:.3f}",
        r"to the left of the line .*?\[m\] ": lambda: f"{truth().y_m:.3f}",
        r"By how many degrees .*?\[°\] ": lambda: f"{math.degrees(truth().heading_rad):.1f}",
        r"Write \S+ ?\[y/n\] ": "y", r"Write .*?\? \[y/n\] ": "y",
    })  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
