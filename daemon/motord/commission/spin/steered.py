# SPDX-License-Identifier: Apache-2.0
"""`motord spin` of a base with steered wheels: where each wheel points, then how each one rolls.

All wheels move at once, since a base moves by twists alone (steered_poses). While the wheels are
pointed, the twist is so slow that they hardly roll."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

from motord.api.snapshot import Snapshot
from motord.client import Client
from motord.commission.person import Person
from motord.commission.session import Held, Session, armed
from motord.commission.spin.procedure import (
    DOUBTS,
    OWNER,
    Direction,
    Turned,
    Wheel,
    ask_what_turned,
    known,
    measured,
    require_idle_ground,
    require_only,
    rim_within_limits,
    spin,
    wheels_of,
    words,
)
from motord.commission.spin.steered_poses import (
    SIDES,
    Module,
    Pose,
    Side,
    modules_of,
    opposite,
    patterns,
    poses_of,
    standing,
    straight,
)

POINTING_RAD_S = 0.3
"""Speed of the fastest wheel while wheels are pointed; no wheel rolls until they point there."""
POINTED_RAD, POINTED_WITHIN_S = 0.03, 5.0
OFF_MAX_DEGREES = 90.0


Procedure: TypeAlias = Callable[[Client, Person, Sequence[str], float, float], list[Turned]]


def procedure_for(robot: Mapping[str, Any]) -> Procedure:
    """Return the procedure for the base in the daemon's answer of `robot`."""
    return spin_steered if robot["modules"] else spin


def spin_steered(
    client: Client, person: Person, names: Sequence[str], speed_rad_s: float, seconds: float
) -> list[Turned]:
    """Point and turn these wheels; the robot is disarmed while the person answers. Raises Failed,
    Aborted, ClientError."""
    robot = client.call("robot")
    wheels = known(wheels_of(robot), names)
    require_idle_ground(client, person, speed_rad_s, seconds)
    run = _Run(client, person, robot, wheels, speed_rad_s, seconds)
    steering = [name for name in names if name in run.steering]
    found = run.steer(steering) if steering else []
    return found + run.roll([name for name in names if name not in run.steering])


class _Run:
    """A spin of one robot on blocks."""

    def __init__(
        self,
        client: Client,
        person: Person,
        robot: Mapping[str, Any],
        wheels: Mapping[str, Wheel],
        speed_rad_s: float,
        seconds: float,
    ) -> None:
        self._client, self._person, self._wheels = client, person, wheels
        self._speed_rad_s, self._seconds = speed_rad_s, seconds
        self._modules: list[Module] = modules_of(robot)
        self._strafes: bool = robot["strafes"]
        self._joints = tuple(robot["joints"])
        self._radius_m = min(robot["wheel_radii_m"].values())
        self.steering = [one.steering for one in self._modules if one.steering]

    # ---------------------------------------------------------------------------------- steering
    def steer(self, names: Sequence[str]) -> list[Turned]:
        """Point the wheels straight ahead, then to each pose, and ask where each one points."""
        at_zero = self._point("straight ahead", straight(self._modules))
        off_rad = {name: self._off_straight(name) for name in names}
        poses = poses_of(self._modules, strafes=self._strafes)
        seen: dict[str, list[Side]] = {name: [] for name in names}
        measured_rad: list[Mapping[str, float]] = []
        for number, pose in enumerate(poses, 1):
            title = f"pose {number} of {len(poses)}"
            pointed = self._point(title, pose)
            # NaN for joints that do not steer
            measured_rad.append(
                {n: pointed.get(n, math.nan) - at_zero.get(n, math.nan) for n in self._joints}
            )
            for name in names:
                seen[name].append(self._side(name))
        expected = patterns(poses)
        tried = {name: tuple(row) for name, row in seen.items()}
        found = []
        for name in names:
            number = next(n for n, pose in enumerate(poses) if pose.side(name) != "straight")
            found.append(
                replace(
                    recognized(name, expected[name], tried),
                    commanded_rad=poses[number].aim_rad[name],
                    counted_rad=measured_rad[number],
                    off_straight_rad=off_rad,
                )
            )
        return found

    def _point(self, title: str, pose: Pose) -> dict[str, float]:
        """Point the wheels, for POINTED_WITHIN_S at most; return the steering joints' angles."""
        places = {name: self._wheels[name].index for name in self.steering}

        def there(newest: Snapshot) -> bool:
            at_rad = {name: newest.joints[place].position_rad for name, place in places.items()}
            return all(abs(at_rad[n] - pose.aim_rad[n]) < POINTED_RAD for n in places)

        def hold(session: Session) -> Held:
            rim_m_s = rim_within_limits(session, _twist(pose), POINTING_RAD_S * self._radius_m)
            self._person.progress(f"{title}: the wheels turn to where they are to point")
            return session.hold(
                pose.linear * rim_m_s, pose.angular * rim_m_s, POINTED_WITHIN_S, there,
                lateral_m_s=pose.lateral * rim_m_s,
            )  # fmt: skip

        held = self._held(hold)
        return {name: held.snapshots[-1].joints[at].position_rad for name, at in places.items()}

    def _off_straight(self, name: str) -> float:
        return math.radians(
            self._person.number(
                f"All wheels are to point straight ahead. By how many degrees does the wheel of "
                f"{name} point to the left (to the right: negative; straight: 0)?",
                "°", -OFF_MAX_DEGREES, OFF_MAX_DEGREES,
            )
        )  # fmt: skip

    def _side(self, name: str) -> Side:
        answer = self._person.choose(f"Where does the wheel of {name} point now?", SIDES)
        return next(side for side in SIDES if side == answer)

    # ----------------------------------------------------------------------------------- traction
    def roll(self, names: Sequence[str]) -> list[Turned]:
        """Turn all wheels forward; then, if the base can, turn it about each wheel, which
        stands."""
        if not names:
            return []
        self._person.show("Now all driven wheels turn forward together, pointing straight ahead")
        held = self._held(lambda session: self._rolled(session, straight(self._modules)), DOUBTS)
        driven = [one.traction for one in self._modules if one.traction]
        found = []
        for name in names:
            turned = replace(
                measured(self._wheels[name], self._joints, held),
                faults=_own_faults(held, self._wheels[name].index),
                together=tuple(driven),
            )
            self._person.show(words(turned))
            found.append(ask_what_turned(self._person, turned, ()))
        if not self._strafes or len(driven) < 2 or held.faults:
            return found
        return [self._placed(turned, found, driven) for turned in found]

    def _placed(self, turned: Turned, seen: Sequence[Turned], driven: Sequence[str]) -> Turned:
        """Find the wheel that this joint turns: it stands while the base turns about it."""
        self._person.show(f"Now the base turns about {turned.joint}, whose wheel is to stand")
        pose = standing(self._modules, turned.joint)
        self._held(lambda session: self._rolled(session, pose))
        wheel = self._person.choose("Which wheel stood?", [*driven, "none"])
        if wheel == "none":
            return replace(turned, note="no wheel stood in a turn about it: is the steering right?")
        seen_of: dict[str, Direction] = {one.joint: one.direction for one in seen}
        direction = seen_of.get(wheel, "forward")
        return replace(turned, seen="" if direction == "not at all" else wheel, direction=direction)

    def _rolled(self, session: Session, pose: Pose) -> Held:
        rim_m_s = rim_within_limits(session, _twist(pose), self._speed_rad_s * self._radius_m)
        self._person.progress("the wheels turn; any key stops them")
        return session.hold(
            pose.linear * rim_m_s, pose.angular * rim_m_s, self._seconds,
            lateral_m_s=pose.lateral * rim_m_s,
        )  # fmt: skip

    def _held(self, motion: Callable[[Session], Held], faults: Iterable[str] = ()) -> Held:
        """Run a motion while armed. Raises Failed if faults other than `faults` have ended it."""
        with armed(self._client, self._person, OWNER) as session:
            held = motion(session)
            require_only(faults, session, held)
            return held


def recognized(
    name: str, expected: tuple[Side, ...], seen: Mapping[str, tuple[Side, ...]]
) -> Turned:
    """Find which wheel the joint points, and whether to the right side. `seen`: sides by wheel."""
    blank = Turned(joint=name, commanded_rad=0.0, counted_rad={}, current_max_a=None, steers=True)
    for wheel in (name, *(one for one in seen if one != name)):
        if seen[wheel] == expected:
            return replace(blank, seen=wheel, direction="forward")
        if seen[wheel] == opposite(expected):
            return replace(blank, seen=wheel, direction="backward")
    if set(seen[name]) == {"straight"}:
        return blank
    return replace(
        blank,
        note=f"its wheel pointed {', '.join(seen[name])} instead of {', '.join(expected)}: "
        "its drive's unit is another wheel's, or a linkage is loose: motord spin --all",
    )


def _own_faults(held: Held, index: int) -> tuple[str, ...]:
    """Return the faults, unless another joint caused them."""
    doubt = held.snapshots[-1].doubt
    return held.faults if doubt is None or doubt.joint == index else ()


def _twist(pose: Pose) -> tuple[float, float, float]:
    return pose.linear, pose.lateral, pose.angular
