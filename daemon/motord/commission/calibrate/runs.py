# SPDX-License-Identifier: Apache-2.0
"""Bounded motions for `calibrate`, each with what a person measures on the floor at its end."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from motord.api.geometry_fit import Array, Measure, Pose
from motord.api.motion import Axis, Goal, Motion
from motord.api.snapshot import Snapshot
from motord.client import Client
from motord.commission.person import Failed, Person
from motord.commission.session import Session, armed

OWNER = "motord-calibrate"
TAPE_M, PROTRACTOR_RAD = 0.002, math.radians(0.5)
"""How exact a person measures with a tape on the floor, and an angle at a mark."""
DEVIATION = Pose(TAPE_M, TAPE_M, PROTRACTOR_RAD, TAPE_M)
SIDEWAYS_MAX_M = 20.0
SETTLE_S = 0.5
_MARK = "of the mark that you made at the start"


@dataclass(slots=True)
class Recorder:
    """Distance that each side's wheels roll, computed with the daemon's radii. For a base without
    two sides, both are the distance ahead by the odometry."""

    robot: dict[str, Any]
    _left_m: list[float] = field(default_factory=list)
    _right_m: list[float] = field(default_factory=list)
    _begin: Snapshot | None = None

    def add(self, snapshot: Snapshot) -> None:
        """Add the newest state. Raises Failed for a wheel without a counter."""
        if two_sided(self.robot):
            left_m, right_m = self._sides(snapshot)
        else:
            left_m = right_m = self._ahead(snapshot)
        self._left_m.append(left_m)
        self._right_m.append(right_m)

    def path(self) -> tuple[Array, Array]:
        """Return the distances of left and right, which begin at 0."""
        left, right = np.array(self._left_m), np.array(self._right_m)
        return left - left[0], right - right[0]

    def _sides(self, snapshot: Snapshot) -> tuple[float, float]:
        rolled: dict[str, list[float]] = {"left": [], "right": []}
        for name, joint in zip(self.robot["joints"], snapshot.joints, strict=True):
            if not math.isfinite(joint.position_rad):
                raise Failed(f"{name}: has no position counter: its travel cannot be calibrated")
            radius_m = self.robot["wheel_radii_m"][name]
            rolled[self.robot["sides"][name]].append(joint.position_rad * radius_m)
        left_m, right_m = (sum(one) / len(one) for one in (rolled["left"], rolled["right"]))
        return left_m, right_m

    def _ahead(self, snapshot: Snapshot) -> float:
        """Return the distance along the first heading; it is proportional to the wheels' radius."""
        begin = self._begin = self._begin or snapshot
        dx_m, dy_m = snapshot.x_m - begin.x_m, snapshot.y_m - begin.y_m
        return dx_m * math.cos(begin.heading_rad) + dy_m * math.sin(begin.heading_rad)


def two_sided(robot: Mapping[str, Any]) -> bool:
    """Return whether a base, by the daemon's answer of `robot`, has wheels on two sides only."""
    return not (robot["strafes"] or robot["modules"])


class Runs:
    """Motions of one robot on the floor. They raise Aborted, Failed, ClientError."""

    def __init__(self, client: Client, person: Person, options: Mapping[str, float]) -> None:
        """`options`: distances and speeds, by the names of motord.api.procedures."""
        self._client, self._person, self._options = client, person, options
        self._robot: dict[str, Any] = client.call("robot")

    def straight(self) -> Iterator[Measure]:
        """Drive forward and back on a line."""
        length_m = self._options["distance_m"]
        self._ready(
            f"Put the robot at the beginning of a straight line on the floor and mark where it "
            f"stands. It drives {length_m:g} m forward and then back, with at most "
            f"{self._options['speed_m_s']:g} m/s. Is the path clear, and does it stand on its mark?"
        )
        recorder = Recorder(self._robot)
        for name, distance_m in (("straight forward", length_m), ("straight back", -length_m)):
            self._drive(name, recorder, [self._move(distance_m)])
            most_m = 1.5 * length_m
            x_m = self._person.number(
                f"How far is the robot now in front {_MARK}, along the line (behind: negative)?",
                "m", -most_m, most_m,
            )  # fmt: skip
            y_m = self._sideways() if two_sided(self._robot) else math.nan
            yield self._measure(name, recorder, Pose(x_m, y_m))

    def rotate(self) -> Iterator[Measure]:
        """Turn on the spot to the left, then to the right."""
        turns = self._options["turns"]
        self._ready(
            f"Mark on the floor where the robot's nose points. It turns {turns:g} times to the "
            f"left and then to the right, with at most {self._options['speed_rad_s']:g} rad/s. "
            "Is there room all around it?"
        )
        before_rad = 0.0
        for name, angle_rad in (("left", turns * math.tau), ("right", -turns * math.tau)):
            recorder = Recorder(self._robot)
            self._drive(f"turns {name}", recorder, [self._turn(angle_rad)])
            after_rad = math.radians(
                self._person.number(
                    "By how many degrees does the nose point to the left of its mark "
                    "(to the right: negative)?", "°", -180.0, 180.0,
                )
            )  # fmt: skip
            pose = Pose(heading_rad=angle_rad + after_rad - before_rad)
            yield self._measure(f"turns {name}", recorder, pose)
            before_rad = after_rad

    def square(self) -> Iterator[Measure]:
        """Drive squares in both directions (UMBmark)."""
        side_m = self._options["side_m"]
        for name, sign in (("left", 1.0), ("right", -1.0)):
            self._ready(
                f"Put the robot on its mark at the beginning of the line, looking along it. It "
                f"drives a square of {side_m:g} m to the {name}. Is the path clear, and does it "
                "stand on its mark?"
            )
            recorder = Recorder(self._robot)
            legs = [self._move(side_m), self._turn(sign * math.pi / 2.0)] * 4
            self._drive(f"square to the {name}", recorder, legs)
            x_m = self._person.number(
                f"How far is the robot now in front {_MARK} (behind: negative)?",
                "m", -SIDEWAYS_MAX_M, SIDEWAYS_MAX_M,
            )  # fmt: skip
            yield self._measure(f"square to the {name}", recorder, Pose(x_m, self._sideways()))

    def _sideways(self) -> float:
        return self._person.number(
            "How far to the left of the line (to the right: negative)?",
            "m", -SIDEWAYS_MAX_M, SIDEWAYS_MAX_M,
        )  # fmt: skip

    def _ready(self, question: str) -> None:
        if not self._person.confirm(question):
            raise Failed("nothing was driven")

    def _move(self, distance_m: float) -> Goal:
        return Goal(axis="linear", distance_u=distance_m, velocity_u_s=self._options["speed_m_s"])

    def _turn(self, angle_rad: float) -> Goal:
        return Goal(axis="angular", distance_u=angle_rad, velocity_u_s=self._options["speed_rad_s"])

    def _drive(self, name: str, recorder: Recorder, goals: Sequence[Goal]) -> None:
        with armed(self._client, self._person, OWNER) as session:
            recorder.add(session.newest())
            for goal in goals:
                session.carry_out(goal, self._watch(name, recorder))
            _settle(session, recorder)

    def _watch(self, name: str, recorder: Recorder) -> Any:
        units: dict[Axis, str] = {"linear": "m", "angular": "rad"}

        def look(motion: Motion, newest: Snapshot) -> None:
            recorder.add(newest)
            unit = units[motion.plan.axis]
            self._person.progress(
                f"{name}: {motion.distance_u:.2f} {unit} of {motion.plan.distance_u:.2f}"
            )

        return look

    @staticmethod
    def _measure(name: str, recorder: Recorder, found: Pose) -> Measure:
        left_m, right_m = recorder.path()
        return Measure(name, left_m, right_m, found, DEVIATION)


def _settle(session: Session, recorder: Recorder) -> None:
    """Record until the last counts have come, one cycle of the line after the rest."""
    for newest in session.wait_still(SETTLE_S):
        recorder.add(newest)
