# SPDX-License-Identifier: Apache-2.0
"""One robot: its simulator, its daemon, a source that drives it, and its faults."""

from __future__ import annotations

import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fault_mix import BATCH_S, SERIAL_KINDS, batches
from reported import Reported

from motord.api.page_file import own_page
from motord.client import Client, ClientError, Refused
from motord.config.drives.load import load_profile
from motord.tools.simulator import start_simulator
from motord_hal.sim.control import ControlError, SimControl
from motord_hal.sim.plant import WheelModel

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
ROBOT = HERE / "four-drives.toml"
PROFILE = HERE / "soak-servo.toml"
LINE = "rs485"
DEADLINE_S = 100.0
RECOVER_S = 100.0
"""Longest time from the last fault's end until the robot moves again: back-off of 2 s, opening,
set-up and arming. A busy machine may delay each."""
REST_S = 5.0
"""Longest time from a latched fault until the wheels rest: 0.5 s of the drives' watchdog, or 2.5 s
in which friction stops a wheel of 12 rad/s without power; the remainder is for a busy machine."""
TURNING_RAD_S = 0.5


class Violation(Exception):
    """The robot did what it must not do, or did not do what it must do."""


@dataclass(slots=True)
class Outcome:
    """The outcome of one robot's life."""

    seed: int
    engine: str
    faults: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    checked_counts: int = 0
    old_answers: int = 0
    oldest_s: float = 0.0
    recoveries: int = 0
    slowest_recovery_s: float = 0.0
    watchdog_bites: int = 0
    gap_violations: int = 0
    duration_s: float = 0.0


def limit_m_s() -> tuple[float, float]:
    """Return the highest speed of a wheel's rim, and its tolerance: half a step of the set-point's
    register, and the deflection of a wheel's speed loop when friction reverses. A step of load
    deflects a PI loop less than a loop with its proportional gain alone."""
    robot = tomllib.loads(ROBOT.read_text(encoding="utf-8"))
    radius_m = robot["base"]["wheel_radius_m"]
    fastest_rad_s = max(joint["velocity_max_rad_s"] for joint in robot["joint"].values())
    model = WheelModel()
    gain = model.inertia_kg_m2 / model.loop_time_s
    rounding_rad_s = 0.5 * load_profile(PROFILE).registers["target_velocity"].to_si(1)
    deflection_rad_s = 2.0 * model.coulomb_n_m / gain
    return fastest_rad_s * radius_m, (rounding_rad_s + deflection_rad_s) * radius_m


def wait_for(condition: Callable[[], Any], within_s: float, what: str) -> Any:
    """Return the first true value of `condition`. Raise Violation at the deadline."""
    end_s = time.monotonic() + within_s
    while not (found := condition()):
        if time.monotonic() > end_s:
            raise Violation(f"{what}: not within {within_s:g} s")
        time.sleep(0.02)
    return found


class Driver(threading.Thread):
    """Commands a random twist and changes it every now and then. Between two twists, and while
    `letting_go` is set, it commands zero: the daemon ignores a source that commanded motion before
    the robot was armed until that source has commanded zero."""

    def __init__(self, path: Path, seed: int) -> None:
        super().__init__(daemon=True)
        self.letting_go = threading.Event()
        self.over = threading.Event()
        self.problem = ""
        self._client = Client(path)
        self._dice = random.Random(seed)

    def run(self) -> None:
        twist, until_s, changed = (0.0, 0.0), 0.0, False
        while not self.over.is_set():
            now_s = time.monotonic()
            if now_s >= until_s:
                twist = (self._dice.uniform(-1.0, 1.0), self._dice.uniform(-1.5, 1.5))
                until_s = now_s + self._dice.uniform(0.3, 1.0)
                changed = True
            zero = self.letting_go.is_set() or changed
            changed = False
            try:
                self._client.drive(*((0.0, 0.0) if zero else twist))
            except Refused:
                pass  # latched: `recover` handles it
            except ClientError as error:
                self.problem = str(error)
                return
            self.over.wait(0.04)
        self._client.close()


@dataclass
class HurtRobot:
    robot: Client
    sim: SimControl
    driver: Driver
    reported: Reported
    log: Path
    daemon: subprocess.Popen[bytes]
    refusal: str = ""
    """Answer of the daemon when it last refused to reset or to arm."""

    # -------------------------------------------------------------------------------- the state
    def status(self) -> dict[str, Any]:
        if self.daemon.poll() is not None:
            raise Violation(f"the daemon has ended with {self.daemon.returncode}")
        if self.driver.problem:
            raise Violation(f"the driving client: {self.driver.problem}")
        return self.robot.status()

    def turns(self) -> bool:
        wheels = self.sim.truth().joints.values()
        return any(abs(wheel.velocity_rad_s) > TURNING_RAD_S for wheel in wheels)

    # ------------------------------------------------------------------------------- the actions
    def recover(self, end_s: float) -> bool:
        """Bring the robot to rest, reset, arm, drive. Return whether it moves before `end_s`."""
        while time.monotonic() < end_s:
            state = self.status()["state"]
            if state in ("armed", "moving"):
                self.driver.letting_go.clear()
                if self.turns():
                    return True
            else:
                self._towards_armed(state)
            time.sleep(0.02)
        return False

    def _towards_armed(self, state: str) -> None:
        self.driver.letting_go.set()
        if state in ("fault", "estop"):
            wait_for(lambda: self.sim.truth().at_rest, REST_S, f"rest after {state}")
        try:
            if state in ("fault", "estop"):
                self.robot.reset()
            elif state == "idle":
                self._arm()
        except Refused as refusal:
            self.refusal = str(refusal)

    def _arm(self) -> None:
        """Arm; reset after a refusal, which a drive needs that latched a fault in idle."""
        try:
            self.robot.arm()
        except Refused as refusal:
            self.refusal = str(refusal)
            self.robot.reset()

    def suffer(self, faults: list[str]) -> float:
        """Inject faults while the robot drives; return the seconds until it moved again."""
        for text in faults:
            self.sim.inject(text)
        end_s = time.monotonic() + BATCH_S + 0.4
        while time.monotonic() < end_s:
            self.recover(end_s)
            time.sleep(0.05)
        self.sim.clear_faults_script()
        began_s = time.monotonic()
        wait_for(lambda: self._plugged(), RECOVER_S, "the plug is in again")
        if not self.recover(began_s + RECOVER_S):
            raise Violation(f"it does not move again: {self.describe()}")
        wait_for(self._all_answer, RECOVER_S, "every drive answers again")
        self.check()
        return time.monotonic() - began_s

    def _plugged(self) -> bool:
        return self.status()["lines"][LINE]["state"] != "closed"

    def _all_answer(self) -> bool:
        found = self.status()
        return not any(joint["stale"] for joint in found["joints"].values())

    def describe(self) -> str:
        found = self.status()
        joints = {name: joint["drive"] for name, joint in found["joints"].items()}
        what = f"{found['state']}, {found['why']}, {found['faults']}, {joints}"
        return f"{what}; it last refused: {self.refusal}"

    # ------------------------------------------------------------------------------- the checks
    def check(self) -> None:
        """Raise Violation if a count was not reported or a wheel was too fast."""
        self.reported.check(self.sim)
        if self.reported.violations:
            raise Violation("; ".join(self.reported.violations[:5]))
        most_m_s, tolerance_m_s = limit_m_s()
        moved_m_s = self.sim.truth().moved_max_m_s
        if not moved_m_s <= most_m_s + tolerance_m_s:
            raise Violation(
                f"a wheel went at {moved_m_s:.4f} m/s, limit {most_m_s} + {tolerance_m_s:.4f}"
            )


@contextlib.contextmanager
def standing(folder: Path, seed: int, engine: str) -> Iterator[HurtRobot]:
    """Run simulator, daemon and driver of one robot until the end of the block."""
    with contextlib.ExitStack() as cleanup:
        simulator = cleanup.enter_context(
            start_simulator(
                ROBOT, seed=seed, link_dir=folder, options=("--tagged",), timeout_s=DEADLINE_S
            )
        )
        name = f"soak{uuid.uuid4().hex[:12]}"
        cleanup.callback(own_page(name).unlink, missing_ok=True)
        log, path, tap = folder / "daemon.log", folder / "daemon.sock", folder / "tap"
        daemon = cleanup.enter_context(_daemon(name, engine, simulator.ports[LINE], folder))
        robot = cleanup.enter_context(_connected(daemon, path, log))
        driver = Driver(path, seed)
        cleanup.callback(driver.join)
        cleanup.callback(driver.over.set)
        driver.start()
        joints = tomllib.loads(ROBOT.read_text(encoding="utf-8"))["joint"].values()
        reported = Reported(
            LINE,
            tuple(joint["unit"] for joint in joints),
            load_profile(PROFILE).registers["position"],
            tap,
        )
        yield HurtRobot(robot, simulator.control, driver, reported, log, daemon)


@contextlib.contextmanager
def _daemon(name: str, engine: str, port: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    settings = (
        f"robot.name={name}", f"line.{LINE}.port={json.dumps(port)}", f"line.{LINE}.engine={engine}"
    )  # fmt: skip
    command = [sys.executable, str(HERE / "tapped_daemon.py"), "run", str(ROBOT)]
    command += ["--socket", str(folder / "daemon.sock")]
    command += [part for setting in settings for part in ("--set", setting)]
    paths = os.pathsep.join(str(ROOT / part) for part in ("daemon", "hal", "."))
    environ = {"PYTHONPATH": paths, "TAP_FILE": str(folder / "tap"), "TAP_JOINTS": "4"}
    with (folder / "daemon.log").open("wb") as log:
        daemon = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log, cwd=ROOT,
            env={**os.environ, **environ},
        )  # fmt: skip
    try:
        yield daemon
    finally:
        daemon.terminate()
        try:
            daemon.wait(DEADLINE_S)
        finally:
            daemon.kill()
            daemon.wait()


def _connected(daemon: subprocess.Popen[bytes], path: Path, log: Path) -> Client:
    def attempt() -> Client | None:
        if daemon.poll() is not None:
            raise Violation(f"the daemon has ended: {log.read_text(encoding='utf-8')}")
        with contextlib.suppress(ClientError):
            return Client(path)
        return None

    found = wait_for(attempt, DEADLINE_S, "the daemon's socket")
    assert isinstance(found, Client)
    return found


def live(
    seed: int,
    engine: str,
    faults: int,
    batch: int,
    kinds: Sequence[str] = SERIAL_KINDS,
    sent: Callable[[str], None] = print,
) -> Outcome:
    """Run one robot from its start to the last fault; return its outcome."""
    outcome = Outcome(seed, engine)
    began_s = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="soak-") as name,
        standing(Path(name), seed, engine) as hurt,
    ):
        script: list[str] = []
        try:
            if not hurt.recover(time.monotonic() + DEADLINE_S):
                raise Violation(f"it does not set off: {hurt.describe()}")
            for drawn in batches(seed, faults, batch, kinds):
                script = [text for _, text in drawn]
                took_s = hurt.suffer(script)
                outcome.faults.update(kind for kind, _ in drawn)
                outcome.recoveries += 1
                outcome.slowest_recovery_s = max(outcome.slowest_recovery_s, took_s)
        except (Violation, ClientError, ControlError) as violation:
            outcome.violations.append(f"seed {seed}, {engine}: {violation}; batch: {script}")
            sent(hurt.log.read_text(encoding="utf-8")[-3000:])
        with contextlib.suppress(ControlError):  # a simulator that is gone is a violation above
            _note(outcome, hurt)
    outcome.duration_s = time.monotonic() - began_s
    return outcome


def _note(outcome: Outcome, hurt: HurtRobot) -> None:
    outcome.checked_counts, outcome.old_answers = hurt.reported.checked, hurt.reported.old
    outcome.oldest_s = hurt.reported.oldest_s
    line = hurt.sim.stats()["lines"][LINE]
    outcome.gap_violations = line["gap_violations"]
    outcome.watchdog_bites = sum(unit["watchdog_bites"] for unit in line["units"].values())
