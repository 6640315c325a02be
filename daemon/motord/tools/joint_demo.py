# SPDX-License-Identifier: Apache-2.0
"""The demonstration of a robot without a base. Each joint goes to both ends and back, or turns in
both directions; the result is compared with the simulator's truth."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motord.config import Robot
from motord.config.sections.joint.wheels import counter_bits, takes_position, velocity_range_rad_s
from motord.tools.demo import (
    COMMAND_PERIOD_S,
    START_DEADLINE_S,
    DemoError,
    Progress,
    Run,
    Stage,
    riding,
    staged,
)

PART = 0.8
"""Part of a joint's range or speed that the demonstration uses."""
ERROR_MAX_RAD = 0.03
"""Largest good error: for a joint that takes positions, between its goal and its true position; for
one that takes velocities, between its measured and its true travel."""
ARRIVES_WITHIN_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class JointScore:
    """The result of one joint."""

    takes: str
    """Kind of set-points of the joint: `position` or `velocity`."""
    source: str
    """`counters`, or `set-points` if no counter measures the joint: its angle is then an
    estimate."""
    travel_rad: float
    """True travel, summed over the legs."""
    error_rad: float
    """Largest error of all legs (see ERROR_MAX_RAD)."""

    @property
    def ok(self) -> bool:
        return self.error_rad <= ERROR_MAX_RAD and self.travel_rad > ERROR_MAX_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class JointResult(Run):
    """The result of a demonstration of joints."""

    joints: dict[str, JointScore]

    @property
    def ok(self) -> bool:
        return self.ended_well and all(score.ok for score in self.joints.values())

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of `motord demo --json`, with the results of the joints in place
        of odometry."""
        joints = {
            name: {
                "takes": score.takes,
                "source": score.source,
                "travel_rad": round(score.travel_rad, 4),
                "error_rad": round(score.error_rad, 5),
            }
            for name, score in self.joints.items()
        }
        return self._json({"joints": joints})


@dataclass(frozen=True, slots=True)
class _Leg:
    position_rad: dict[str, float]
    velocity_rad_s: dict[str, float]


def legs_of(robot: Robot) -> list[_Leg]:
    """Return the three legs: joints that take positions go to one end, to the other one, and back;
    others turn forward, backward if they can, and come to rest."""
    legs = [_Leg({}, {}) for _ in range(3)]
    for name, joint in robot.joint.items():
        profile = robot.profiles[joint.drive]
        positions = takes_position(joint, profile)
        if positions:
            ends = joint.position_max_rad or 0.0, joint.position_min_rad or 0.0
        else:
            ends = velocity_range_rad_s(joint, profile)[::-1]
        for leg, end in zip(legs, (*ends, 0.0), strict=True):
            (leg.position_rad if positions else leg.velocity_rad_s)[name] = PART * end
    return legs


def run_joint_demo(
    robot_file: Path,
    robot: Robot,
    seconds: float,
    progress: Progress,
    stay: Callable[[Stage], None] | None = None,
) -> JointResult:
    """Move each joint and measure, for at least `seconds`. `stay` and errors as in `run_demo`."""
    with staged(robot_file, robot.overrides) as stage:
        progress("starting the drives")
        stage.wait("drives ready", lambda status: status["state"] == "idle", START_DEADLINE_S)
        with riding(stage) as ride:
            scores = _drive(stage, robot, seconds, progress)
        status = stage.robot.status()
        if stay is not None:
            stay(stage)
        return JointResult(
            robot=robot.robot.name,
            seconds=ride.seconds,
            joints=scores,
            status=status,
            clean_exit=stage.stop_daemon(),
        )


def _drive(stage: Stage, robot: Robot, seconds: float, progress: Progress) -> dict[str, JointScore]:
    profiles = robot.profiles
    legs = legs_of(robot)
    error = dict.fromkeys(robot.joint, 0.0)
    travel = dict.fromkeys(robot.joint, 0.0)
    true_rad, shown_rad = _positions(stage)
    for number, leg in enumerate(legs, 1):
        progress(f"leg {number} of {len(legs)}")
        _follow(stage, leg, seconds / len(legs))
        now_rad, now_shown_rad = _positions(stage)
        for name in robot.joint:
            travel[name] += abs(now_rad[name] - true_rad[name])
            goal_rad = leg.position_rad.get(name)
            if goal_rad is not None:
                off_rad = abs(now_rad[name] - goal_rad)
            else:
                moved_rad = now_rad[name] - true_rad[name]
                off_rad = abs(now_shown_rad[name] - shown_rad[name] - moved_rad)
            error[name] = max(error[name], off_rad)
        true_rad, shown_rad = now_rad, now_shown_rad
    return {
        name: JointScore(
            takes="position" if name in legs[0].position_rad else "velocity",
            source="counters" if counter_bits(joint, profiles[joint.drive]) else "set-points",
            travel_rad=travel[name],
            error_rad=error[name],
        )
        for name, joint in robot.joint.items()
    }


def _follow(stage: Stage, leg: _Leg, seconds: float) -> None:
    """Send the commands of a leg for this time, and until all joints have reached their positions
    and are at rest. Raise DemoError if they are not in time."""
    start_s = time.monotonic()
    while True:
        stage.check()
        elapsed_s = time.monotonic() - start_s
        turning = leg.velocity_rad_s if elapsed_s < seconds else {}
        stage.robot.joints(leg.position_rad, turning, owner="demo")
        if elapsed_s >= seconds and _arrived(stage, leg):
            return
        if elapsed_s > seconds + ARRIVES_WITHIN_S:
            raise DemoError(f"a joint did not come to rest in its place\n{stage.tail()}")
        time.sleep(COMMAND_PERIOD_S)


def _arrived(stage: Stage, leg: _Leg) -> bool:
    truth, shown = stage.sim.truth(), stage.robot.status()["joints"]
    there = (
        (at_rad := shown[name]["position_rad"]) is not None and abs(at_rad - goal) <= ERROR_MAX_RAD
        for name, goal in leg.position_rad.items()
    )
    return truth.at_rest and all(there)


def _positions(stage: Stage) -> tuple[dict[str, float], dict[str, float]]:
    """Return the true and the reported position of each joint. Call it when the joints rest."""
    truth, shown = stage.sim.truth().joints, stage.robot.status()["joints"]
    return (
        {name: joint.position_rad for name, joint in truth.items()},
        {name: joint["position_rad"] or 0.0 for name, joint in shown.items()},
    )
