# SPDX-License-Identifier: Apache-2.0
"""The demonstration: simulated drives and the daemon, each its own process, and a course.

Nothing is special about the daemon here: it is the one that `motord run` starts, and what drives it
is the client that any program uses.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motord.client import Client, ClientError, Refused
from motord.page_file import FOLDER, PREFIX
from motord.tools.course import Pose, Score, command_at, score
from motord.tools.simulator import start_simulator
from motord_hal.sim.control import RobotTruth, SimControl

COMMAND_PERIOD_S = 0.05
PATH_PERIOD_S = 0.1
START_DEADLINE_S = 20.0
REST_DEADLINE_S = 10.0
STOP_DEADLINE_S = 10.0

Progress = Callable[[str], None]
_stages = itertools.count(1)


class DemoError(Exception):
    """The demonstration could not be driven to its end; the message says why."""


@dataclass(frozen=True, slots=True)
class Result:
    """What was measured in this run, and nothing else."""

    robot: str
    seconds: float
    score: Score
    path: list[tuple[float, float]]
    status: dict[str, Any]
    clean_exit: bool

    @property
    def ok(self) -> bool:
        quiet = self.status["state"] == "idle" and not self.status["faults"]
        return self.score.ok and quiet and self.clean_exit

    def to_json(self) -> dict[str, Any]:
        """The keys of `motord demo --json`."""
        lines = self.status["lines"]
        return {
            "robot": self.robot,
            "ok": self.ok,
            "seconds": round(self.seconds, 3),
            "engine": {name: line["engine"] for name, line in lines.items()},
            "odometry": {
                "distance_m": round(self.score.distance_m, 4),
                "position_error_m": round(self.score.position_error_m, 5),
                "heading_error_rad": round(self.score.heading_error_rad, 5),
                "distance_error_percent": round(self.score.distance_error_percent, 4),
                "drift_percent": round(self.score.drift_percent, 4),
                "jumps": sum(joint["jumps"] for joint in self.status["joints"].values()),
            },
            "loop": self.status["loop"],
            "lines": lines,
            "safety": {
                "final_state": self.status["state"],
                "faults": self.status["faults"],
                "stops": self.status["stops"],
            },
            "clean_exit": self.clean_exit,
        }


@dataclass(frozen=True, slots=True)
class Stage:
    """The two processes, and how to reach them."""

    daemon: subprocess.Popen[bytes]
    log: Path
    robot: Client
    sim: SimControl
    socket: Path

    def check(self) -> None:
        if self.daemon.poll() is not None:
            raise DemoError(f"the daemon ended with {self.daemon.returncode}:\n{self.tail()}")

    def tail(self, lines: int = 15) -> str:
        return "\n".join(self.log.read_text(encoding="utf-8").splitlines()[-lines:])

    def wait(self, what: str, until: Callable[[dict[str, Any]], bool], deadline_s: float) -> None:
        end = time.monotonic() + deadline_s
        while True:
            self.check()
            status = self.robot.status()
            if until(status):
                return
            if time.monotonic() > end:
                raise DemoError(
                    f"{what}: not within {deadline_s} s, state is {status['state']}\n{self.tail()}"
                )
            time.sleep(0.05)

    def stop_daemon(self) -> bool:
        """As a service manager would. True when it ended by itself and well."""
        self.daemon.send_signal(signal.SIGTERM)
        try:
            return self.daemon.wait(STOP_DEADLINE_S) == 0
        except subprocess.TimeoutExpired:
            return False


def connect(daemon: subprocess.Popen[bytes], socket: Path, log: Path) -> Client:
    """The daemon's socket appears when it listens."""
    end = time.monotonic() + START_DEADLINE_S
    while daemon.poll() is None and time.monotonic() < end:
        with contextlib.suppress(ClientError):
            return Client(socket)
        time.sleep(0.05)
    raise DemoError(f"the daemon did not start:\n{log.read_text(encoding='utf-8')}")


@contextlib.contextmanager
def staged(robot_file: Path) -> Iterator[Stage]:
    """Simulated drives and a daemon on them; both are gone afterwards, whatever happened."""
    with contextlib.ExitStack() as cleanup:
        folder = Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix="motord-demo-")))
        sim = cleanup.enter_context(start_simulator(robot_file, link_dir=folder))
        log, socket = folder / "daemon.log", folder / "daemon.sock"
        # a name of its own: a daemon of the same robot may be running on this machine
        name = f"{robot_file.stem}-{os.getpid()}-{next(_stages)}"
        settings = [f"--set=robot.name={name}"]
        settings += [f"--set={setting}" for setting in sim.settings]
        cleanup.callback((FOLDER / f"{PREFIX}{name}").unlink, missing_ok=True)
        with log.open("wb") as sink:
            daemon = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "motord",
                    "run",
                    str(robot_file),
                    *settings,
                    "--socket",
                    str(socket),
                ],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=sink,
            )
        cleanup.callback(end, daemon)
        client = cleanup.enter_context(connect(daemon, socket, log))
        yield Stage(daemon, log, client, sim.control, socket)


def end(daemon: subprocess.Popen[bytes]) -> None:
    """Last resort: the drives' own watchdogs stop the wheels."""
    if daemon.poll() is None:
        daemon.kill()
        daemon.wait()


def drive(stage: Stage, seconds: float, progress: Progress) -> list[tuple[float, float]]:
    """The course, as a program on the robot would drive it; where odometry saw the robot go."""
    path: list[tuple[float, float]] = []
    start = due = time.monotonic()
    while (elapsed_s := time.monotonic() - start) < seconds:
        stage.check()
        linear_m_s, angular_rad_s = command_at(elapsed_s, seconds)
        stage.robot.drive(linear_m_s, angular_rad_s, owner="demo")
        if elapsed_s >= len(path) * PATH_PERIOD_S:
            odometry = stage.robot.status()["odometry"]
            path.append((odometry["x_m"], odometry["y_m"]))
            progress(
                f"{elapsed_s:5.1f} s of {seconds:.0f}   {odometry['distance_m']:5.2f} m   "
                f"{odometry['linear_m_s']:5.2f} m/s {odometry['angular_rad_s']:5.2f} rad/s"
            )
        due += COMMAND_PERIOD_S
        time.sleep(max(due - time.monotonic(), 0.0))
    return path


def run_demo(
    robot_file: Path,
    robot: str,
    seconds: float,
    progress: Progress,
    stay: Callable[[Stage], None] | None = None,
) -> Result:
    """Drive the course once and measure; `stay` may then keep the stage up. Raises DemoError."""
    with staged(robot_file) as stage:
        progress("starting the drives")
        stage.wait("drives ready", lambda status: status["state"] == "idle", START_DEADLINE_S)
        stage.sim.reset_truth()
        stage.robot.reset_odometry()
        stage.robot.arm()
        start = time.monotonic()
        try:
            path = drive(stage, seconds, progress)
            stage.robot.stop()
        except Refused as refusal:
            raise DemoError(f"{refusal}\n{stage.tail()}") from refusal
        stage.wait("rest after the course", lambda status: status["at_rest"], REST_DEADLINE_S)
        seconds = time.monotonic() - start
        stage.robot.disarm()
        status, truth = stage.robot.status(), stage.sim.truth()
        if stay is not None:
            stay(stage)
        return Result(
            robot, seconds, measure(status, truth), path, status, clean_exit=stage.stop_daemon()
        )


def measure(status: dict[str, Any], truth: RobotTruth) -> Score:
    """Both have come to rest: where each says that the robot is."""
    said = status["odometry"]
    return score(
        Pose(said["x_m"], said["y_m"], said["heading_rad"], said["distance_m"]),
        Pose(truth.x_m, truth.y_m, truth.heading_rad, truth.distance_m),
    )
