# SPDX-License-Identifier: Apache-2.0
"""A command of motord at a pseudo-terminal, and a simulated person who types and measures. The
robot's file is a copy; the simulated robot may differ from it.
"""

import contextlib
import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

from tests.fork_server import AT_TERMINAL
from tests.sim.daemon_stage import (
    DEADLINE_S,
    ROBOT,
    ROOT,
    TRIES,
    becomes_idle,
    running,
    wait_until,
    was_held_up,
)

SETTINGS = (
    "loop.rate_hz=250", "input.socket.kind=socket", "input.socket.lease_s=1.0",
    "safety.command_timeout_s=1.0",
)  # fmt: skip
"""Settings with which a delay by a busy machine is no fault."""


class Screen:
    """Output of a command at a terminal, and its keyboard."""

    def __init__(self, process, master):
        self.process, self.master, self.text, self._seen = process, master, "", 0

    def _read(self, within_s):
        if not select.select([self.master], [], [], within_s)[0]:
            return True
        try:
            data = os.read(self.master, 65536)
        except OSError:  # the other end is closed
            return False
        # drop progress lines, which are overwritten
        text = data.decode(errors="replace").replace("\r\n", "\n")
        self.text += re.sub(r"\r\x1b\[K[^\n\r]*", "", text)
        return bool(data)

    def wait(self, pattern):
        """Wait for the pattern in the text after the previous match; return the match."""
        end_s = time.monotonic() + DEADLINE_S
        while not (found := re.search(pattern, self.text[self._seen :])):
            assert time.monotonic() < end_s, f"{pattern}: not within {DEADLINE_S} s\n{self.text}"
            assert self._read(0.1), f"{pattern}: it ended before\n{self.text}"
        self._seen += found.end()
        return found

    def until(self, condition, what):
        """Wait for the condition; fail if the command ends first."""

        def found():
            ended = self.process.poll() is not None
            holds = condition()
            assert holds or not ended, f"{what}: the command ended before"
            return holds

        wait_until(found, what)

    def type(self, text):
        os.write(self.master, text.encode())

    def answers(self, replies):
        """Answer each question until the command ends; return the exit status. `replies`: pattern
        of a question → its answer, or a function that returns it."""
        pattern = "|".join(f"(?:{one})" for one in replies)
        while True:
            end_s = time.monotonic() + DEADLINE_S
            while not (found := re.search(pattern, self.text[self._seen :])):
                assert time.monotonic() < end_s, f"no question within {DEADLINE_S} s\n{self.text}"
                if not self._read(0.1):
                    return self.process.wait(DEADLINE_S)
            self._seen += found.end()
            reply = next(
                reply for one, reply in replies.items() if re.fullmatch(one, found[0], re.DOTALL)
            )
            self.type(f"{reply() if callable(reply) else reply}\n")

    def answer(self, pattern, text):
        found = self.wait(pattern)
        self.type(f"{text}\n")
        return found

    def end(self):
        """Wait until the command ends; return its exit status. `text` is complete then."""
        end_s = time.monotonic() + DEADLINE_S
        while self._read(0.1) and time.monotonic() < end_s:
            pass
        return self.process.wait(DEADLINE_S)

    def hang_up(self):
        """Close the terminal, as a broken SSH connection does."""
        os.close(self.master)
        self.master = -1


@contextlib.contextmanager
def at_terminal(*words):
    """Run `motord WORDS` with a controlling terminal of its own; yield its Screen."""
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [*AT_TERMINAL, sys.executable, "-m", "motord", *map(str, words)],
        stdin=slave, stdout=slave, stderr=slave, cwd=ROOT, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    os.close(slave)
    screen = Screen(process, master)
    try:
        yield screen
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGKILL)
        process.wait()
        while screen.master >= 0 and select.select([master], [], [], 0.0)[0] and screen._read(0.0):
            pass
        print(screen.text)  # pytest shows it when the test fails
        if screen.master >= 0:
            os.close(master)


def copied(folder, robot=ROBOT, replaced=()):
    """Return a copy of a robot file. `replaced`: pairs of an old and a new text."""
    place = Path(folder) / "cart.toml"
    text = robot.read_text(encoding="utf-8")
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    place.write_text(text, encoding="utf-8")
    return place


@contextlib.contextmanager
def robot_of(folder, file, *settings, truth=(), wheels=(), faults=(), simulator=()):
    """Run a daemon with `file`. The simulated robot differs from the file by `truth`, settings of
    the simulator, and by `wheels`, the wheels' physics. `simulator`: more options of it."""
    options = [part for setting in truth for part in ("--set", setting)]
    options += [part for setting in wheels for part in ("--wheel", setting)]
    options += simulator
    joints = tomllib.loads(file.read_text(encoding="utf-8"))["joint"]
    patient = ("tries=10", "reply_timeout_s=0.2")
    tries = [f"joint.{name}.{setting}" for name in joints for setting in patient]
    with running(
        Path(folder), *SETTINGS, *tries, *settings, robot=file, sim_options=options, faults=faults
    ) as stage:
        stage.wait_for("idle")
        yield stage


class Floor:
    """A person with a tape measure and marks on the floor, who measures the simulator's truth."""

    def __init__(self, stage):
        self._sim = stage.sim

    def back_on_mark(self):
        self._sim.reset_truth()
        return "y"

    def along(self):
        return f"{self._sim.truth().x_m:.3f}"

    def sideways(self):
        return f"{self._sim.truth().y_m:.3f}"

    def degrees(self):
        return f"{round(2 * math.degrees(self._sim.truth().heading_rad)) / 2:g}"

    def replies(self, write="y"):
        return {
            r"does it stand on its mark\? \[y/n\] ": self.back_on_mark,
            r"Is there room all around( it)?\? \[y/n\] ": self.back_on_mark,
            r"in front of the mark .*?\? \[m\] ": self.along,
            r"How far to the left of the line .*?\? \[m\] ": self.sideways,
            r"By how many degrees .*?\? \[°\] ": self.degrees,
            r"Is the path clear\? \[y/n\] ": "y",
            r"Write \S+cart\.toml\? \[y/n\] ": write,
        }


def calibrated(stage, *words, write="y"):
    """Run `motord calibrate WORDS`, answered by a Floor; return exit status and text. Repeat it
    where a busy machine held it up, up to TRIES times."""
    for number in range(TRIES):
        if number:
            becomes_idle(stage)
        with at_terminal("calibrate", *words, "--socket", stage.socket) as screen:
            status = screen.answers(Floor(stage).replies(write))
            if status == 0 or not was_held_up(screen.text):
                break
    return status, screen.text
