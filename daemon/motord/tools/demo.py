# SPDX-License-Identifier: Apache-2.0
"""The demonstration: simulated drives and the daemon, each in its own process, and a course.

The daemon is the ordinary one that `motord run` starts, and the ordinary client commands it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import os
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motord.api.page_file import own_page
from motord.base.python_command import module_command
from motord.client import Client, ClientError, Refused
from motord.config import Robot
from motord.config.sections.bases import CarBase
from motord.config.sections.imu import ChipImu
from motord.config.sections.joint.wheels import all_reverse, counter_bits
from motord.tools.course import (
    CAR,
    COURSE,
    CURVES,
    STRAFING,
    Course,
    Pose,
    Score,
    command_at,
    score,
)
from motord.tools.demo_words import Source, held_up_words, worth
from motord.tools.simulator import start_simulator
from motord_hal.sim.control import RobotTruth, SimControl
from motord_hal.sim.runner import punctual

COMMAND_PERIOD_S = 0.05
PATH_PERIOD_S = 0.1
START_DEADLINE_S = 60.0
REST_DEADLINE_S = 10.0
STOP_DEADLINE_S = 10.0
NICE = -10
"""Nice value of the daemon, if the system allows it: a robot's computer does little else."""

Progress = Callable[[str], None]
_stages = itertools.count(1)


class DemoError(Exception):
    """The demonstration failed; the message contains the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """The measured values of one run."""

    robot: str
    seconds: float
    status: dict[str, Any]
    clean_exit: bool

    @property
    def ended_well(self) -> bool:
        """Whether the run ended well, without regard to the measured values."""
        idle = self.status["state"] == "idle" and not self.status["faults"]
        return idle and self.clean_exit

    @property
    def ok(self) -> bool:
        """Whether the run ended well, and the measured values are good."""
        return self.ended_well

    def _json(self, measured: Mapping[str, Any]) -> dict[str, Any]:
        lines = self.status["lines"]
        return {
            "robot": self.robot,
            "ok": self.ok,
            "seconds": round(self.seconds, 3),
            "engine": {name: line["engine"] for name, line in lines.items()},
            **measured,
            "loop": self.status["loop"],
            "lines": lines,
            "safety": {
                "final_state": self.status["state"],
                "faults": self.status["faults"],
                "stops": self.status["stops"],
            },
            "clean_exit": self.clean_exit,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Result(Run):
    """The result of a course."""

    score: Score
    path: list[tuple[float, float]]
    source: Source = Source.COUNTERS
    chip_imu: bool = False
    """Whether the robot file has a gyro chip, which is not simulated."""
    drives_held_up_s: float = 0.0
    program_held_up_s: float = 0.0
    """Longest time for which this program got no processor; the field above is for the simulated
    drives."""
    daemon_waited_part: float = 0.0
    """Part of its time that the daemon's main thread waited for a processor."""

    @property
    def ok(self) -> bool:
        judged = self.source is Source.COUNTERS
        good = self.score.ok if judged else self.score.ok_as_estimate
        return good and self.ended_well

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of `motord demo --json`."""
        measured = {
            "odometry": {
                "distance_m": round(self.score.distance_m, 4),
                "position_error_m": round(self.score.position_error_m, 5),
                "heading_error_rad": round(self.score.heading_error_rad, 5),
                "distance_error_percent": round(self.score.distance_error_percent, 4),
                "drift_percent": round(self.score.drift_percent, 4),
                "jumps": sum(joint["jumps"] for joint in self.status["joints"].values()),
                "source": self.source.value,
                "judged": self.source is Source.COUNTERS,
            },
            "worth": worth(self.source, self.score),
            "held_up_s": {
                "drives": round(self.drives_held_up_s, 3),
                "program": round(self.program_held_up_s, 3),
            },
            "daemon_waited_part": round(self.daemon_waited_part, 3),
        }
        return self._json(measured)


@dataclass(frozen=True, slots=True)
class Stage:
    """The two processes (simulator and daemon) and the connections to them."""

    daemon: subprocess.Popen[bytes]
    log: Path
    robot: Client
    sim: SimControl
    socket: Path

    def drives_held_up_s(self) -> float:
        return float(self.sim.stats()["held_up_max_s"])

    def daemon_waited_s(self) -> float:
        """Return the time that the daemon has waited for a processor since its start; 0 if the
        kernel has no CONFIG_SCHED_INFO."""
        try:
            text = Path(f"/proc/{self.daemon.pid}/schedstat").read_text(encoding="ascii")
        except OSError:
            return 0.0
        return int(text.split()[1]) * 1e-9

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
        """Stop the daemon as a service manager does. Return whether it ended in time and well."""
        self.daemon.send_signal(signal.SIGTERM)
        try:
            return self.daemon.wait(STOP_DEADLINE_S) == 0
        except subprocess.TimeoutExpired:
            return False


def connect(daemon: subprocess.Popen[bytes], socket: Path, log: Path) -> Client:
    """Connect to the daemon once it listens on its socket. Raise DemoError if it does not."""
    end = time.monotonic() + START_DEADLINE_S
    while daemon.poll() is None and time.monotonic() < end:
        with contextlib.suppress(ClientError):
            return Client(socket)
        time.sleep(0.05)
    raise DemoError(f"the daemon did not start:\n{log.read_text(encoding='utf-8')}")


@contextlib.contextmanager
def staged(robot_file: Path, overrides: Sequence[str] = ()) -> Iterator[Stage]:
    """Run simulated drives and a daemon on them in this block; both are gone afterwards, whatever
    happened. Both get priority over other programs, if the system allows it. Otherwise a simulator
    without a processor leaves a counter unchanged, which a loop in time takes for a standing
    wheel."""
    with contextlib.ExitStack() as cleanup:
        folder = Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix="motord-demo-")))
        options = [f"--set={setting}" for setting in overrides]
        options += ["--priority=1"] if cleanup.enter_context(punctual()) else []
        sim = cleanup.enter_context(start_simulator(robot_file, link_dir=folder, options=options))
        log, socket = folder / "daemon.log", folder / "daemon.sock"
        # its own name, because a daemon of the same robot may run on this machine
        name = f"{robot_file.stem}-{os.getpid()}-{next(_stages)}"
        settings = [*overrides, f"robot.name={name}", *sim.settings]
        cleanup.callback(own_page(name).unlink, missing_ok=True)
        with log.open("wb") as sink:
            daemon = subprocess.Popen(
                module_command(
                    "motord", "run", str(robot_file),
                    *(f"--set={setting}" for setting in settings), "--socket", str(socket),
                ),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=sink,
            )  # fmt: skip
        cleanup.callback(end, daemon)
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, daemon.pid, NICE)
        client = cleanup.enter_context(connect(daemon, socket, log))
        yield Stage(daemon, log, client, sim.control, socket)


def end(daemon: subprocess.Popen[bytes]) -> None:
    """Kill the daemon if it still runs. The drives' own watchdogs then stop the wheels."""
    if daemon.poll() is None:
        daemon.kill()
        daemon.wait()


@dataclass(slots=True)
class Ride:
    """The data of one drive over a course."""

    path: list[tuple[float, float]] = field(default_factory=list)
    """Positions (x, y) in m, by odometry."""
    held_up_s: float = 0.0
    """Greatest lateness of a command."""
    seconds: float = 0.0
    """Duration until the robot was at rest again."""
    began_s: float = field(default_factory=time.monotonic)
    daemon_waited_before_s: float = 0.0

    def daemon_waited_part(self, stage: Stage) -> float:
        waited_s = stage.daemon_waited_s() - self.daemon_waited_before_s
        return waited_s / (time.monotonic() - self.began_s)


@contextlib.contextmanager
def riding(stage: Stage) -> Iterator[Ride]:
    """Arm the robot for this block; then bring it to rest and disarm it. Raise DemoError if the
    daemon refuses a request."""
    stage.robot.arm()
    ride = Ride(daemon_waited_before_s=stage.daemon_waited_s())
    try:
        yield ride
    except Refused as refusal:
        raise DemoError(refused(stage, ride, refusal)) from refusal
    with contextlib.suppress(Refused):  # a stop that takes longer than [limits] allow
        stage.robot.stop()
    stage.wait("rest after the course", lambda status: status["at_rest"], REST_DEADLINE_S)
    ride.seconds = time.monotonic() - ride.began_s
    stage.robot.disarm()


def drive(stage: Stage, course: Course, seconds: float, progress: Progress, ride: Ride) -> None:
    """Drive the course, as a program on the robot does."""
    start = due = time.monotonic()
    while (elapsed_s := time.monotonic() - start) < seconds:
        stage.check()
        ride.held_up_s = max(ride.held_up_s, start + elapsed_s - due)
        stage.robot.drive(*command_at(elapsed_s, seconds, course), owner="demo")
        if elapsed_s >= len(ride.path) * PATH_PERIOD_S:
            odometry = stage.robot.status()["odometry"]
            ride.path.append((odometry["x_m"], odometry["y_m"]))
            progress(
                f"{elapsed_s:5.1f} s of {seconds:.0f}   {odometry['distance_m']:5.2f} m   "
                f"{_speed(odometry['linear_m_s'])} m/s {_speed(odometry['angular_rad_s'])} rad/s"
            )
        due = max(due + COMMAND_PERIOD_S, start + elapsed_s)
        time.sleep(max(due - time.monotonic(), 0.0))


def _speed(value: float | None) -> str:
    """Return the speed for the progress; a dash if the wheels do not determine it."""
    return "    –" if value is None else f"{value:5.2f}"


def run_demo(
    robot_file: Path,
    robot: Robot,
    seconds: float,
    progress: Progress,
    stay: Callable[[Stage], None] | None = None,
) -> Result:
    """Drive the course once and measure. `stay` is called at the end, while both processes still
    run. Raise DemoError if the demonstration fails."""
    with staged(robot_file, robot.overrides) as stage:
        progress("starting the drives")
        stage.wait("drives ready", lambda status: status["state"] == "idle", START_DEADLINE_S)
        stage.sim.reset_truth()
        stage.robot.reset_odometry()
        with riding(stage) as ride:
            drive(stage, course_of(robot), seconds, progress, ride)
        status, truth = stage.robot.status(), stage.sim.truth()
        held_up_s, waited_part = stage.drives_held_up_s(), ride.daemon_waited_part(stage)
        if stay is not None:
            stay(stage)
        return Result(
            robot=robot.robot.name,
            seconds=ride.seconds,
            score=measure(status, truth),
            path=ride.path,
            status=status,
            clean_exit=stage.stop_daemon(),
            source=source_of(robot),
            chip_imu=isinstance(robot.imu, ChipImu),
            drives_held_up_s=held_up_s,
            program_held_up_s=ride.held_up_s,
            daemon_waited_part=waited_part,
        )


DASHBOARD = "dashboard"
"""Name of the [input.*] that the demonstration adds."""


def show_dashboard(
    robot_file: Path, robot: Robot, port: int, stay: Callable[[Stage], None]
) -> None:
    """Run both processes with a dashboard at that port, without a course, until `stay` returns.
    Raise DemoError if that fails."""
    if _listens(port):
        raise DemoError(f"another program listens at TCP port {port}: choose another with --port")
    table = f"input.{DASHBOARD}"
    settings = [f"{table}.kind=web", f"{table}.port={port}", f"{table}.trust_loopback=true"]
    with tempfile.TemporaryDirectory(prefix="motord-recordings-") as folder:
        if importlib.util.find_spec("mcap") is not None:
            table = f"publish.{DASHBOARD}"
            settings += [f"{table}.kind=mcap", f"{table}.folder={json.dumps(folder)}"]
            settings += [f"{table}.mode=manual", f"{table}.journal=true"]
        _show(robot_file, (*robot.overrides, *settings), port, stay)


def _show(
    robot_file: Path, settings: Sequence[str], port: int, stay: Callable[[Stage], None]
) -> None:
    with staged(robot_file, settings) as stage:
        stage.wait("drives ready", lambda status: status["state"] == "idle", START_DEADLINE_S)
        stage.wait("the dashboard", lambda _: _listens(port), START_DEADLINE_S)
        stay(stage)


def _listens(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
        return True
    return False


def course_of(robot: Robot) -> Course:
    """Return the course that fits the robot's base."""
    if robot.base.strafes:
        return STRAFING
    if isinstance(robot.base, CarBase):
        return CAR
    return COURSE if all_reverse(robot) else CURVES


def source_of(robot: Robot) -> Source:
    """Return what odometry is computed from: the least exact source of all wheels."""
    sources = {Source.COUNTERS}
    for joint in robot.joint.values():
        profile = robot.profiles[joint.drive]
        if not counter_bits(joint, profile):
            measures = profile.channels[joint.channel].velocity is not None
            sources.add(Source.SPEEDS if measures else Source.SETPOINTS)
    return max(sources, key=list(Source).index)


def refused(stage: Stage, ride: Ride, refusal: Refused) -> str:
    """Return why the course ended early: the refused request, the daemon's reasons, whether this
    machine was too busy, and the end of the log."""
    why = stage.robot.status()["why"]
    busy = held_up_words(stage.drives_held_up_s(), ride.held_up_s, ride.daemon_waited_part(stage))
    parts = [str(refusal), *(f"because: {text}" for text in why), busy, stage.tail()]
    return "\n".join(part for part in parts if part)


def measure(status: dict[str, Any], truth: RobotTruth) -> Score:
    """Compare the pose of odometry with the true one, after the robot has come to rest."""
    odometry = status["odometry"]
    return score(
        Pose(odometry["x_m"], odometry["y_m"], odometry["heading_rad"], odometry["distance_m"]),
        Pose(truth.x_m, truth.y_m, truth.heading_rad, truth.distance_m),
    )
