# SPDX-License-Identifier: Apache-2.0
"""Accuracy with which `motord calibrate` recovers the geometry of a robot that differs from its
file, on the simulator, and the factor by which the error at the end of a square falls.

python -m tests.bench.calibration: one JSON object.
"""

from __future__ import annotations

import contextlib
import json
import math
import tempfile
from typing import Any

from tests.sim.daemon_stage import ROOT, SURE, armed, wait_until
from tests.sim.person_stage import calibrated, copied, robot_of

from motord.client import MoveFailed
from motord.config import load_robot

RADIUS_M, TRACK_M = 0.0825, 0.45
TRUE = {"left": 1.03 * RADIUS_M, "right": 1.02 * RADIUS_M, "track": 0.96 * TRACK_M}
TRUTH = (
    f"joint.left.wheel_radius_m={TRUE['left']}",
    f"joint.right.wheel_radius_m={TRUE['right']}",
    f"base.track_m={TRUE['track']}",
)
FORWARD_ONLY = ROOT / "config/robots/forward-only.toml"
FRICTION = ("left.coulomb_n_m=0.48", "right.coulomb_n_m=0.48")
"""Friction of a motor that stalls at 8 N·m: a dead band of 6 %."""
SHORT = ("--distance-m", "1", "--turns", "1", "--side-m", "1")
"""A course that is only long enough to show that the calibration runs."""
TRIES = 4
"""Number of tries: a busy machine may hold up the simulated robot for too long."""
FULL_DUTY_RAD_S = 8.0 * 0.94 / (8.0 / 18.0 + 0.02)
"""Speed at a duty of 1: 8 N·m · (duty − 0.06) = (8 / 18 + 0.02) N·m·s/rad · speed."""


def square_error_m(stage: Any, side_m: float) -> float:
    """Return the distance between the true end of a square and that of the odometry: the mean of a
    square to the left and one to the right (UMBmark: the return position error)."""
    errors_m = []
    while len(errors_m) < 2:
        sign = -1.0 if errors_m else 1.0
        with armed(stage), contextlib.suppress(MoveFailed):  # repeated on a busy machine
            stage.sim.reset_truth()
            stage.robot.reset_odometry()
            for _ in range(4):
                stage.robot.move(side_m, speed_m_s=0.4)
                stage.robot.turn(sign * math.pi / 2.0, speed_rad_s=0.8)
            wait_until(lambda: stage.sim.truth().at_rest, "rest")
            truth, odometry = stage.sim.truth(), stage.robot.status().odometry
            errors_m.append(math.hypot(truth.x_m - odometry.x_m, truth.y_m - odometry.y_m))
    return sum(errors_m) / len(errors_m)


def geometry(side_m: float, *course: str) -> dict[str, Any]:
    """Return errors of radii, track and square. `course`: options of `motord calibrate`."""
    with tempfile.TemporaryDirectory() as folder:
        file = copied(folder)
        with robot_of(folder, file, *SURE, truth=TRUTH) as stage:
            before_m = square_error_m(stage, side_m)
            for _ in range(TRIES):
                status, text = calibrated(stage, "all", "--speed-m-s", "0.4", *course)
                if status == 0:
                    break
            assert status == 0, text
        with robot_of(folder, file, *SURE, truth=TRUTH) as stage:
            after_m = square_error_m(stage, side_m)
        robot = load_robot(file)
    found = {name: robot.wheel_radius_m(name) for name in ("left", "right")}
    found["track"] = robot.base.track_m
    off = {name: found[name] / true - 1.0 for name, true in TRUE.items()}
    return {"off": off, "side_m": side_m, "before_m": before_m, "after_m": after_m,
            "ratio": before_m / after_m}  # fmt: skip


def duty() -> dict[str, float]:
    """Return the relative errors of the dead band and of the speed at full duty."""
    with tempfile.TemporaryDirectory() as folder:
        given = [("duty_dead_band = 0.06", "duty_dead_band = 0.02")]
        file = copied(folder, FORWARD_ONLY, given)
        with robot_of(folder, file, wheels=FRICTION) as stage:
            status, text = calibrated(stage, "feedforward", "--speed-m-s", "0.5")
            assert status == 0, text
        joint = load_robot(file).joint["left"]
    return {"dead_band": joint.duty_dead_band / 0.06 - 1.0,
            "full_duty": joint.full_duty_rad_s / FULL_DUTY_RAD_S - 1.0}  # fmt: skip


def measure(side_m: float = 4.0, course: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the figures of geometry and duty."""
    return {"geometry": geometry(side_m, *course), "duty": duty()}


def table(found: dict[str, Any]) -> str:
    made, motor = found["geometry"], found["duty"]
    off = ", ".join(f"{name} {part:+.2%}" for name, part in made["off"].items())
    return (
        f"calibrated on a robot with radii +3 % and +2 %, track -4 %: off by {off}\n"
        f"a square of {made['side_m']:g} m ends {1e3 * made['before_m']:.0f} mm from where the "
        f"odometry has it before, {1e3 * made['after_m']:.1f} mm after: {made['ratio']:.0f} times "
        "closer\n"
        f"dead band of 6 %: off by {motor['dead_band']:+.1%} of it; speed at full duty: "
        f"{motor['full_duty']:+.1%}"
    )


def verdicts(found: dict[str, Any]) -> list[tuple[str, bool, bool]]:
    made, motor = found["geometry"], found["duty"]
    return [
        ("radii and track are recovered within 0.3 %",
         max(map(abs, made["off"].values())) < 0.003, False),
        ("dead band and friction are recovered within 5 %",
         max(map(abs, motor.values())) < 0.05, False),
        ("the end error of a square falls ten times or more", made["ratio"] >= 10.0, False),
    ]  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(measure(), indent=1))
